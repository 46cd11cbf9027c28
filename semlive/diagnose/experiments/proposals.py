"""Proposal of the next experiment that separates the remaining candidates, as a change of the protocol of the run."""

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
    """Kinds of experiments."""

    STATIONARY_SERIES = "parked"
    """Pairs without a load and without a move."""
    REPEAT = "again"
    """The calibration again, without a load."""
    LONGER_HOLD = "longer_hold"
    """The same loads, held four times as long."""
    ZERO_LOAD_STEPS = "dummy_steps"
    """Every load twice: the second step changes nothing."""
    UNLOAD = "unload"
    """The same loads, followed by unloading."""
    REVERSED = "reversed"
    """Every move there and back."""
    CHANGED_SCAN_TIMES = "other_scan"
    """The calibration again with another dwell or row time, which the operator sets."""
    CHANGED_PIXEL_SIZE = "other_magnification"
    """The calibration again at another magnification and, where stated, with another dwell, both of which the operator sets."""
    ROTATED_SCAN = "turned_scan"
    """A calibration with large moves, and the same again with the scan rotated by 90 degrees, which the operator sets."""


_KIND_BY_EFFECT = {
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
_KIND_BY_GROUP = {
    "G1": ExperimentKind.STATIONARY_SERIES,
    "G2": ExperimentKind.STATIONARY_SERIES,
    "G3": ExperimentKind.CHANGED_SCAN_TIMES,
    "G4": ExperimentKind.CHANGED_SCAN_TIMES,
    "G8": ExperimentKind.STATIONARY_SERIES,
    "G11": ExperimentKind.UNLOAD,
}


@dataclass(frozen=True, slots=True)
class Proposal:
    """Proposal of the next experiment.

    Attributes:
        kind: kind of the experiment.
        candidates: effects to be separated.
        description: purpose of the experiment, one sentence.
        forecast: expected log odds; None if no forecast is possible.
    """

    kind: ExperimentKind
    candidates: tuple[str, ...]
    description: str
    forecast: ExperimentForecast | None = None


_DESCRIPTIONS = {
    ExperimentKind.STATIONARY_SERIES: "changes without loading and moves",
    ExperimentKind.REPEAT: "changes since the first calibration",
    ExperimentKind.LONGER_HOLD: "transients that decay only in longer holds",
    ExperimentKind.ZERO_LOAD_STEPS: "effects of a load step without a change of load",
    ExperimentKind.UNLOAD: "effects that reverse with the load",
    ExperimentKind.REVERSED: "effects of a move and its reversal",
    ExperimentKind.CHANGED_SCAN_TIMES: (
        "effects that follow the dwell or row time and not the position in the image; see `semlive experiment decide`"
    ),
    ExperimentKind.CHANGED_PIXEL_SIZE: (
        "settling at the start of rows or frames in time, in position or in pixels: a change of pixel size and dwell, not by one factor "
        "or inverse ones, separates all three; see `semlive experiment decide`"
    ),
    ExperimentKind.ROTATED_SCAN: (
        "effects that rotate with the scan: pixels that are not square, skewed axes, nonlinear ramps; see `semlive experiment decide`"
    ),
}


def requested_proposal(kind: ExperimentKind) -> Proposal:
    """A proposal of a given kind, independent of a diagnosis."""
    return Proposal(kind, (), _DESCRIPTIONS[kind])


def choose_proposal(verdict: Diagnosis, menu: Sequence[ExperimentForecast] = ()) -> Proposal | None:
    """The experiment that separates the candidates of a verdict; None if there is nothing to decide.

    For an identified effect it is the experiment that confirms it; for an unknown effect, a stationary series. If forecasts are available,
    it is the decisive experiment with the least beam time; if none is decisive, the proposal of the effect class is used.

    Args:
        verdict: the verdict.
        menu: forecasts in descending order of log odds per minute; empty uses those of the verdict.
    """
    between = verdict.ambiguous or tuple(effect.name for effect in verdict.effects)
    if verdict.outcome is Outcome.NONE:
        return None
    if not between:
        return Proposal(
            ExperimentKind.STATIONARY_SERIES,
            (),
            "changes without loading and moves are due to the microscope, all others to loads or moves",
        )
    best = fastest_decisive(menu or (() if verdict.experiment is None else verdict.experiment.forecasts))
    if best is not None:
        return Proposal(ExperimentKind(best.kind), between, _DESCRIPTIONS[ExperimentKind(best.kind)], best)
    non_map = non_map_effect(verdict.effects[0].model_effect.name)
    if non_map is not None:
        return Proposal(_KIND_BY_EFFECT.get(non_map.name, ExperimentKind.CHANGED_SCAN_TIMES), between, non_map.discriminating_experiment)
    family = effect_class(verdict.effects[0].model_effect.name)
    kind = _KIND_BY_EFFECT.get(family.name) or _KIND_BY_GROUP.get(family.group or "", ExperimentKind.STATIONARY_SERIES)
    return Proposal(kind, between, family.discriminating_experiment)


def ranked(proposal: ExperimentProposal, menu: Sequence[ExperimentForecast]) -> ExperimentProposal:
    """A proposal with forecasts; its text begins with the fastest decisive experiment, if there is one."""
    best = fastest_decisive(menu)
    description = (
        proposal.about
        if best is None
        else f"{best.summary}, {best.minutes:.0f} minutes: {_DESCRIPTIONS[ExperimentKind(best.kind)]} (or: {proposal.about})"
    )
    return replace(proposal, about=description, forecasts=tuple(menu))


def fastest_decisive(menu: Sequence[ExperimentForecast]) -> ExperimentForecast | None:
    """The decisive experiment with the largest log odds per minute; None if none is decisive."""
    return next((forecast for forecast in menu if forecast.log_odds > MIN_LOG_ODDS), None)
