"""Values that describe an experiment: phases, steps, holds, limits."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Phase(StrEnum):
    """Purpose of a pair."""

    CALIBRATION = "calibration"
    TRANSLATION = "translation"
    TENSION = "tension"


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the experiment: move, hold, take a pair.

    Attributes:
        step: running number from 0; the pair of the step has the same number.
        phase: purpose of the pair.
        shift_um: commanded stage position (x, y) relative to its position at the start of the run.
        shift_px: shift of the plan in pixels; `shift_um` also contains the recentring of the field of view (see `Recentre`).
        load_n: commanded load; None: the load does not change.
        warm_up: whether the step was added to measure the drift again while the warm-up gate waited (see `WarmUp`).
    """

    step: int
    phase: Phase
    shift_um: tuple[float, float]
    shift_px: tuple[float, float]
    load_n: float | None
    warm_up: bool = False

    @property
    def number(self) -> int:
        """Number of the step from 1, as in messages."""
        return self.step + 1


@dataclass(frozen=True, slots=True)
class HoldRule:
    """Conditions for the imaging of a step.

    Attributes:
        hold_s: hold between the end of settling and the first frame of the pair (paper: 30 s).
        settle_s: time for which load and stage must stay within tolerance before the hold.
        load_tolerance_n: allowed distance of the load from its target.
        load_tolerance_fraction: allowed distance as a fraction of the target; the larger of the two tolerances applies.
        stage_tolerance_um: allowed distance of the stage reading from its target.
        motion_timeout_s: time after which a motion that has not settled is a fault.
        frame_timeout_s: time of imaging without an acceptable frame that is a fault.
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
    """Soft limits, checked for every command and every sample.

    Attributes:
        force_min_n: lowest allowed force.
        force_max_n: highest allowed force.
        extension_min_mm: lowest allowed crosshead extension.
        extension_max_mm: highest allowed crosshead extension.
        force_rate_max_n_s: maximum rate of a commanded ramp.
        force_step_max_n: maximum commanded change of load in one step.
        stage_travel_um: largest allowed distance of the stage from its position at the start of the run, per axis.
        stale_after_s: age after which the last sample is stale and not used for decisions, s of wall time.
        lost_after_s: time without a sample after which the link counts as lost and the run stops, s of wall time.
        force_drop_max_n: largest sudden decrease of the load (slip, fracture); None: not checked.
        force_slope_max_n_s: maximum rate of the measured load over half a second; None: not checked.
        slack_max_mm: maximum travel of the crosshead while the load changes by less than `slack_force_n`; None: the travel that
            follows from the configured stiffness and the distance to the force limit.
        slack_force_n: change of load for `slack_max_mm`.
        unloaded_max_n: largest load, N, of pairs before the first load; None: 5 % of the larger force limit. The load tolerance is
            always allowed; 0 forbids an additional preload.
        stiffness_min_n_mm: smallest change of load per travel of every ramp, N/mm, from the first change of load in the ramp on; a
            smaller value counts as a fault of the load cell. The limit also applies during yielding. None: not checked.
        stop_timeout_s: maximum time after a stop until the devices report that they do not move; then the run ends, s of experiment time.
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
    """Compensation of drift by moving the field of view back to its planned position.

    Attributes:
        threshold_px: distance from the planned position up to which nothing is moved.
        um_per_px: motion of stage or beam shift that moves the image by one pixel.
    """

    threshold_px: float
    um_per_px: float


@dataclass(frozen=True, slots=True)
class WarmUp:
    """Drift before the experiment continues; until it is slow or settled, additional pairs are taken at the present position.

    Attributes:
        max_rate_px_s: maximum of forecast drift rate plus standard uncertainty; None: not checked.
        max_wait_s: waiting time after which the operator decides, or the run continues.
        gate_phases: TENSION: the gate is before the first load; CALIBRATION: after the first pair.
        max_change_px_s: maximum change of the forecast drift rate from pair to pair, plus standard uncertainty; None: not checked.
        continue_after_wait: whether the run continues after the waiting time without a decision of the operator; never to a load.
    """

    max_rate_px_s: float | None
    max_wait_s: float
    gate_phases: Phase = Phase.TENSION
    max_change_px_s: float | None = None
    continue_after_wait: bool = False


@dataclass(frozen=True, slots=True)
class AdaptiveHold:
    """Conditions that extend a hold.

    Attributes:
        max_hold_s: maximum duration of a hold.
        max_rate_px_s: maximum drift rate between frames of the hold, or else of its forecast; None: not checked.
        max_relaxation_n_s: maximum rate of change of the load; None: not checked.
    """

    max_hold_s: float
    max_rate_px_s: float | None = None
    max_relaxation_n_s: float | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """A complete experiment.

    Attributes:
        steps: steps in their order.
        hold: conditions for the imaging of a step.
        limits: soft limits.
        ramp_rate_n_s: rate of load changes.
        triggered: trigger the SEM for each frame; otherwise it scans continuously and exports every frame.
        recentring: compensation of drift and specimen motion before each step; None: no compensation.
        warm_up: condition for the drift rate before the first load; None: no condition.
        adaptive_hold: conditions that extend a hold; None: every hold has the planned duration.
        calibration_gate: load the specimen only after the translations were verified to determine the distortion.
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
