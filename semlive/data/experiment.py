"""The experiment as data: phases, steps, holds, limits."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Phase(StrEnum):
    """What a pair is for."""

    CALIBRATION = "calibration"
    TRANSLATION = "translation"
    TENSION = "tension"


@dataclass(frozen=True, slots=True)
class Step:
    """One stop of the experiment: get there, hold, take a pair.

    Attributes:
        step: running number from 0; the step's pair has the same number.
        phase: what the pair is for.
        shift_um: commanded stage position (x, y) relative to where the run began.
        shift_px: planned shift, pixels; `shift_um` also includes recentring (see `Recentre`).
        load_n: commanded load, or None to leave the load frame alone.
        warm_up: whether the warm-up gate added the step to measure the drift again (see `WarmUp`).
    """

    step: int
    phase: Phase
    shift_um: tuple[float, float]
    shift_px: tuple[float, float]
    load_n: float | None
    warm_up: bool = False

    @property
    def number(self) -> int:
        """Number of the step counted from 1, as in messages to the operator."""
        return self.step + 1


@dataclass(frozen=True, slots=True)
class HoldRule:
    """When a step may be imaged.

    Attributes:
        hold_s: time between "settled" and the first frame of the pair (30 s in Sutton et al. 2007).
        settle_s: time that load and stage must stay within tolerance to count as settled.
        load_tolerance_n: allowed deviation of the load from its target.
        load_tolerance_fraction: allowed deviation as a fraction of the target; the larger of both applies.
        stage_tolerance_um: allowed distance of the stage's own reading from its target.
        motion_timeout_s: a motion not settled after this is a fault.
        frame_timeout_s: no acceptable frame for this long while imaging is a fault.
    """

    hold_s: float = 30.0
    settle_s: float = 5.0
    load_tolerance_n: float = 10.0
    load_tolerance_fraction: float = 0.01
    stage_tolerance_um: float = 5.0
    motion_timeout_s: float = 900.0
    frame_timeout_s: float = 900.0

    def load_tolerance(self, target_n: float) -> float:
        """Allowed distance of the load from `target_n`, in N."""
        return max(self.load_tolerance_n, self.load_tolerance_fraction * abs(target_n))


@dataclass(frozen=True, slots=True)
class Limits:
    """Soft limits, checked on every command and on every sample.

    Attributes:
        force_min_n: lowest allowed force.
        force_max_n: highest allowed force.
        extension_min_mm: lowest allowed crosshead extension.
        extension_max_mm: highest allowed crosshead extension.
        force_rate_max_n_s: fastest commanded ramp.
        force_step_max_n: largest commanded change of load in one step.
        stage_travel_um: largest allowed distance of the stage from where the run began, per axis.
        stale_after_s: wall seconds after which the last sample is stale (no decisions on it).
        lost_after_s: wall seconds after which the link is lost (stop).
        force_drop_max_n: largest sudden fall of the load (a slip, a fracture); None: not checked.
        force_slope_max_n_s: fastest change of the measured load over half a second; None: not checked.
        slack_max_mm: maximum crosshead travel while the load changes by less than `slack_force_n`; None: as far as the
            stated stiffness and the distance to the force limit allow.
        slack_force_n: see `slack_max_mm`.
        unloaded_max_n: largest load, N, of pairs before the first load step; None: 5 % of the larger force limit. The load tolerance
            is allowed in any case, so 0 forbids an intended preload.
        stiffness_min_n_mm: smallest load change per travel of every ramp, N/mm, from the first change of load in the ramp on; below it the
            reading of the load cell counts as too low. It applies to yielding as well. None: not checked.
        stop_timeout_s: maximum wait of a stopped run for standstill reports of the devices, experiment seconds.
    """

    force_min_n: float
    force_max_n: float
    extension_min_mm: float
    extension_max_mm: float
    force_rate_max_n_s: float
    force_step_max_n: float
    stage_travel_um: float
    stale_after_s: float = 0.5
    lost_after_s: float = 2.0
    force_drop_max_n: float | None = None
    force_slope_max_n_s: float | None = None
    slack_max_mm: float | None = None
    slack_force_n: float = 5.0
    stop_timeout_s: float = 20.0
    unloaded_max_n: float | None = None
    stiffness_min_n_mm: float | None = None


@dataclass(frozen=True, slots=True)
class Recentre:
    """Recentring of the field of view on its planned position.

    Attributes:
        threshold_px: offset above which the field is recentred.
        um_per_px: motion of the stage or the beam shift that moves the image by a pixel.
    """

    threshold_px: float
    um_per_px: float


@dataclass(frozen=True, slots=True)
class WarmUp:
    """Drift rate below which the experiment continues; until then, further pairs measure the drift at the current position.

    Attributes:
        max_rate_px_s: the forecast drift rate plus its standard uncertainty must not exceed this.
        max_wait_s: time after which the operator is prompted.
        gate_phases: TENSION: the gate is before the first load; CALIBRATION: after the first pair.
    """

    max_rate_px_s: float
    max_wait_s: float
    gate_phases: Phase = Phase.TENSION


@dataclass(frozen=True, slots=True)
class AdaptiveHold:
    """Conditions that extend a hold beyond its minimum.

    Attributes:
        max_hold_s: maximum duration of the hold.
        max_rate_px_s: largest drift rate between frames of the hold (or its forecast) at which the hold ends; None: not checked.
        max_relaxation_n_s: largest rate of load change at which the hold ends, N/s; None: not checked.
    """

    max_hold_s: float
    max_rate_px_s: float | None = None
    max_relaxation_n_s: float | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """An experiment: its steps, limits and optional gates.

    Attributes:
        steps: in order.
        hold: when a step may be imaged.
        limits: soft limits.
        ramp_rate_n_s: rate of load changes.
        triggered: semlive triggers each scan; otherwise the SEM scans continuously and exports every frame.
        recentring: compensation of drift and specimen motion before each step; None: none.
        warm_up: drift rate required before the first load; None: no gate.
        adaptive_hold: conditions that extend a hold; None: none.
        calibration_gate: loading starts only after the translations determine the distortion.
    """

    steps: tuple[Step, ...]
    hold: HoldRule
    limits: Limits
    ramp_rate_n_s: float
    triggered: bool = False
    recentring: Recentre | None = None
    warm_up: WarmUp | None = None
    adaptive_hold: AdaptiveHold | None = None
    calibration_gate: bool = False
