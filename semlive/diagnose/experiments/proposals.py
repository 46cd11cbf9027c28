"""The next experiment: what decides between effects, as a change of the protocol that the daemon runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from semlive.data.diagnosis.effects import Outcome
from semlive.data.diagnosis.verdict import Diagnosis, ExperimentForecast, ExperimentProposal
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.maps.effect_selection import MIN_LOG_ODDS
from semlive.model.effects.stage import non_map_effect


class ExperimentKind(StrEnum):
    """What can be done to a run."""

    STATIONARY_SERIES = "parked"
    """Pairs without a load and without a move."""
    REPEAT = "again"
    """The calibration once more, without a load."""
    LONGER_HOLD = "longer_hold"
    """The same loads, held four times as long."""
    ZERO_LOAD_STEPS = "dummy_steps"
    """Every load twice: the second step changes nothing."""
    UNLOAD = "unload"
    """The same loads, and back down."""
    REVERSED = "reversed"
    """Every move there and back."""
    CHANGED_SCAN_TIMES = "other_scan"
    """The calibration once more with another dwell or row time, which the operator sets."""
    ROTATED_SCAN = "turned_scan"
    """A calibration with large moves, and the same once more with the scan turned by 90 degrees, which the operator sets."""


_DECIDES = {
    "creep_in_hold": ExperimentKind.LONGER_HOLD,
    "load_step_transient": ExperimentKind.ZERO_LOAD_STEPS,
    "stage_step_transient": ExperimentKind.REVERSED,
    "distortion_scale_drift": ExperimentKind.REPEAT,
    "wrong_row_time": ExperimentKind.CHANGED_SCAN_TIMES,
    "scan_shear_drift": ExperimentKind.ROTATED_SCAN,
    "aspect_drift": ExperimentKind.ROTATED_SCAN,
    "drift_jump": ExperimentKind.STATIONARY_SERIES,
    "charging_local_lens": ExperimentKind.REVERSED,
    "dic_subpixel_bias": ExperimentKind.STATIONARY_SERIES,
    "stage_backlash": ExperimentKind.REVERSED,
    "stage_quadratic": ExperimentKind.REVERSED,
    "friction_hysteresis": ExperimentKind.UNLOAD,
    "load_cell_zero": ExperimentKind.STATIONARY_SERIES,
    "load_cell_drift": ExperimentKind.STATIONARY_SERIES,
    "out_of_plane_translation": ExperimentKind.UNLOAD,
    "timestamp_offset": ExperimentKind.STATIONARY_SERIES,
    "contamination": ExperimentKind.REPEAT,
    "defocus": ExperimentKind.REPEAT,
    "gamma_change": ExperimentKind.REPEAT,
    "charging_jump": ExperimentKind.REPEAT,
}
_BY_GROUP = {
    "G1": ExperimentKind.STATIONARY_SERIES,
    "G2": ExperimentKind.STATIONARY_SERIES,
    "G3": ExperimentKind.CHANGED_SCAN_TIMES,
    "G4": ExperimentKind.CHANGED_SCAN_TIMES,
    "G8": ExperimentKind.STATIONARY_SERIES,
    "G11": ExperimentKind.UNLOAD,
}


@dataclass(frozen=True, slots=True)
class Proposal:
    """What to do next.

    Attributes:
        kind: of the experiment.
        candidates: the effects that it is about.
        description: what it shows, one sentence.
        foretold: what it is expected to decide; None where that cannot be foretold.
    """

    kind: ExperimentKind
    candidates: tuple[str, ...]
    description: str
    forecast: ExperimentForecast | None = None


_ABOUT = {
    ExperimentKind.STATIONARY_SERIES: "what goes on while nothing is loaded or moved",
    ExperimentKind.REPEAT: "what has changed since the first calibration",
    ExperimentKind.LONGER_HOLD: "what comes to rest only after longer holds",
    ExperimentKind.ZERO_LOAD_STEPS: "what a load step does that changes no load",
    ExperimentKind.UNLOAD: "what goes back with the load",
    ExperimentKind.REVERSED: "what a move does that is taken back",
    ExperimentKind.CHANGED_SCAN_TIMES: (
        "what goes with the dwell or the row time and not with the place in the picture; `semlive experiment decide` tells"
    ),
    ExperimentKind.ROTATED_SCAN: (
        "what turns with the scan: pixels that are not square, skewed axes, curved ramps; `semlive experiment decide` tells"
    ),
}


def requested_proposal(kind: ExperimentKind) -> Proposal:
    """An experiment, whatever a diagnosis leaves open."""
    return Proposal(kind, (), _ABOUT[kind])


def choose_proposal(found: Diagnosis, menu: Sequence[ExperimentForecast] = ()) -> Proposal | None:
    """What would decide; None where there is nothing to decide.

    Of an identified effect it is the experiment that confirms the name; of what has no name, a series in which nothing is done. Where
    odds are foretold, it is the experiment that decides in the least beam time; where none decides, what is known of the effect counts.

    Args:
        found: the verdict.
        menu: what experiments are expected to decide, the most for a minute first; none takes the verdict's own.
    """
    between = found.ambiguous or tuple(effect.name for effect in found.effects)
    if found.outcome is Outcome.NONE:
        return None
    if not between:
        return Proposal(
            ExperimentKind.STATIONARY_SERIES,
            (),
            "what goes on while nothing is loaded or moved belongs to the microscope, the rest to what was done",
        )
    best = fastest_decisive(menu or (() if found.experiment is None else found.experiment.forecasts))
    if best is not None:
        return Proposal(ExperimentKind(best.kind), between, _ABOUT[ExperimentKind(best.kind)], best)
    non_map = non_map_effect(found.effects[0].model_effect.name)
    if non_map is not None:
        return Proposal(_DECIDES.get(non_map.name, ExperimentKind.CHANGED_SCAN_TIMES), between, non_map.discriminating_experiment)
    family = effect_class(found.effects[0].model_effect.name)
    kind = _DECIDES.get(family.name) or _BY_GROUP.get(family.group or "", ExperimentKind.STATIONARY_SERIES)
    return Proposal(kind, between, family.discriminating_experiment)


def ranked(found: ExperimentProposal, menu: Sequence[ExperimentForecast]) -> ExperimentProposal:
    """An experiment's words with what each one would decide: the quickest that decides is said first, before what decides by its nature."""
    best = fastest_decisive(menu)
    about = (
        found.about
        if best is None
        else f"{best.summary}, {best.minutes:.0f} minutes: {_ABOUT[ExperimentKind(best.kind)]} (or: {found.about})"
    )
    return replace(found, about=about, forecasts=tuple(menu))


def fastest_decisive(menu: Sequence[ExperimentForecast]) -> ExperimentForecast | None:
    """The experiment that decides and gives the most for a minute; None where none decides."""
    return next((proposal for proposal in menu if proposal.log_odds > MIN_LOG_ODDS), None)
