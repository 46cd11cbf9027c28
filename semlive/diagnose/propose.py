"""The next experiment: what decides between effects, as a change of the protocol that the daemon runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from semlive.data.diagnosis import Diagnosis, Experiment, Foretold, Outcome
from semlive.diagnose.known import family_of
from semlive.diagnose.named import ODDS
from semlive.model.move_effects import beside_maps


class Kind(StrEnum):
    """What can be done to a run."""

    PARKED = "parked"
    """Pairs without a load and without a move."""
    AGAIN = "again"
    """The calibration once more, without a load."""
    LONGER_HOLD = "longer_hold"
    """The same loads, held four times as long."""
    DUMMY_STEPS = "dummy_steps"
    """Every load twice: the second step changes nothing."""
    UNLOAD = "unload"
    """The same loads, and back down."""
    REVERSED = "reversed"
    """Every move there and back."""
    OTHER_SCAN = "other_scan"
    """The calibration once more with another dwell or row time, which the operator sets."""
    TURNED_SCAN = "turned_scan"
    """A calibration with large moves, and the same once more with the scan turned by 90 degrees, which the operator sets."""


_DECIDES = {
    "creep_in_hold": Kind.LONGER_HOLD,
    "load_step_transient": Kind.DUMMY_STEPS,
    "stage_step_transient": Kind.REVERSED,
    "distortion_scale_drift": Kind.AGAIN,
    "wrong_row_time": Kind.OTHER_SCAN,
    "scan_shear_drift": Kind.TURNED_SCAN,
    "aspect_drift": Kind.TURNED_SCAN,
    "drift_jump": Kind.PARKED,
    "charging_local_lens": Kind.REVERSED,
    "dic_subpixel_bias": Kind.PARKED,
    "stage_backlash": Kind.REVERSED,
    "stage_quadratic": Kind.REVERSED,
    "friction_hysteresis": Kind.UNLOAD,
    "load_cell_zero": Kind.PARKED,
    "load_cell_drift": Kind.PARKED,
    "out_of_plane_translation": Kind.UNLOAD,
    "timestamp_offset": Kind.PARKED,
    "contamination": Kind.AGAIN,
    "defocus": Kind.AGAIN,
    "gamma_change": Kind.AGAIN,
    "charging_jump": Kind.AGAIN,
}
_BY_GROUP = {"G1": Kind.PARKED, "G2": Kind.PARKED, "G3": Kind.OTHER_SCAN, "G4": Kind.OTHER_SCAN, "G8": Kind.PARKED, "G11": Kind.UNLOAD}


@dataclass(frozen=True, slots=True)
class Proposal:
    """What to do next.

    Attributes:
        kind: of the experiment.
        between: the effects that it is about.
        about: what it shows, one sentence.
        foretold: what it is expected to decide; None where that cannot be foretold.
    """

    kind: Kind
    between: tuple[str, ...]
    about: str
    foretold: Foretold | None = None


_ABOUT = {
    Kind.PARKED: "what goes on while nothing is loaded or moved",
    Kind.AGAIN: "what has changed since the first calibration",
    Kind.LONGER_HOLD: "what comes to rest only after longer holds",
    Kind.DUMMY_STEPS: "what a load step does that changes no load",
    Kind.UNLOAD: "what goes back with the load",
    Kind.REVERSED: "what a move does that is taken back",
    Kind.OTHER_SCAN: "what goes with the dwell or the row time and not with the place in the picture; `semlive experiment decide` tells",
    Kind.TURNED_SCAN: "what turns with the scan: pixels that are not square, skewed axes, curved ramps; `semlive experiment decide` tells",
}


def asked_for(kind: Kind) -> Proposal:
    """An experiment, whatever a diagnosis leaves open."""
    return Proposal(kind, (), _ABOUT[kind])


def proposed(found: Diagnosis, menu: Sequence[Foretold] = ()) -> Proposal | None:
    """What would decide; None where there is nothing to decide.

    Of an identified effect it is the experiment that confirms the name; of what has no name, a series in which nothing is done. Where
    odds are foretold, it is the experiment that decides in the least beam time; where none decides, what is known of the effect counts.

    Args:
        found: the verdict.
        menu: what experiments are expected to decide, the most for a minute first; none takes the verdict's own.
    """
    between = found.ambiguous or tuple(one.name for one in found.effects)
    if found.outcome is Outcome.NONE:
        return None
    if not between:
        return Proposal(
            Kind.PARKED, (), "what goes on while nothing is loaded or moved belongs to the microscope, the rest to what was done"
        )
    best = quickest(menu or (() if found.experiment is None else found.experiment.foretold))
    if best is not None:
        return Proposal(Kind(best.kind), between, _ABOUT[Kind(best.kind)], best)
    beside = beside_maps(found.effects[0].law.name)
    if beside is not None:
        return Proposal(_DECIDES.get(beside.name, Kind.OTHER_SCAN), between, beside.decides)
    family = family_of(found.effects[0].law.name)
    kind = _DECIDES.get(family.name) or _BY_GROUP.get(family.group or "", Kind.PARKED)
    return Proposal(kind, between, family.decides)


def ranked(found: Experiment, menu: Sequence[Foretold]) -> Experiment:
    """An experiment's words with what each one would decide: the quickest that decides is said first, before what decides by its nature."""
    best = quickest(menu)
    about = found.about if best is None else f"{best.said}, {best.minutes:.0f} minutes: {_ABOUT[Kind(best.kind)]} (or: {found.about})"
    return replace(found, about=about, foretold=tuple(menu))


def quickest(menu: Sequence[Foretold]) -> Foretold | None:
    """The experiment that decides and gives the most for a minute; None where none decides."""
    return next((one for one in menu if one.log_odds > ODDS), None)
