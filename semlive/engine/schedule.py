"""Expected duration of an experiment, computed before the run."""

from __future__ import annotations

import math
from dataclasses import dataclass

from semlive.data.experiment import Phase, Plan


@dataclass(frozen=True, slots=True)
class TimingAssumptions:
    """Assumed durations that the plan does not state, s.

    Attributes:
        scan_s: one frame, from its first pixel to its last.
        export_s: from the end of a scan until its file counts as complete.
        move_s: a motion of the stage.
    """

    scan_s: float
    export_s: float = 3.0
    move_s: float = 5.0


@dataclass(frozen=True, slots=True)
class StepTime:
    """Expected times of one step, all in s.

    Attributes:
        step: number of the step.
        phase: purpose of its pair.
        begins_s: begin of the step after the begin of the run.
        motion_s: until load and stage have arrived and settled.
        hold_s: rest before the pair.
        imaging_s: until both frames are complete; a scan under way when the hold ends does not count.
    """

    step: int
    phase: Phase
    begins_s: float
    motion_s: float
    hold_s: float
    imaging_s: float

    @property
    def ends_s(self) -> float:
        """End of the step after the begin of the run, s."""
        return self.begins_s + self.motion_s + self.hold_s + self.imaging_s


@dataclass(frozen=True, slots=True)
class Schedule:
    """Expected times of an experiment.

    Attributes:
        steps: expected times of the steps, in order.
        max_waiting_s: longest additional time for drift and relaxation, s.
        scans: number of scans of the field: every exported frame, or two for each pair if frames are triggered.
    """

    steps: tuple[StepTime, ...]
    max_waiting_s: float
    scans: int

    @property
    def duration_s(self) -> float:
        """Time from the begin to the end of the last pair, s, without waiting for drift or relaxation."""
        return self.steps[-1].ends_s if self.steps else 0.0

    @property
    def pair_frames(self) -> int:
        """Frames that are analysed."""
        return 2 * len(self.steps)


def schedule(plan: Plan, pace: TimingAssumptions) -> Schedule:
    """Expected times of every step.

    Args:
        plan: the experiment.
        pace: assumed durations that the plan does not state.
    """
    # A triggered frame is requested when the previous one is complete; without a trigger the next scan follows at once.
    pair_s = 2.0 * pace.scan_s + pace.export_s + (pace.export_s if plan.triggered else 0.0)
    steps: list[StepTime] = []
    load_n, shift_um, now_s, max_waiting_s = 0.0, (0.0, 0.0), 0.0, 0.0
    for step in plan.steps:
        ramp_s = 0.0 if step.load_n is None else abs(step.load_n - load_n) / plan.ramp_rate_n_s
        move_s = pace.move_s if step.shift_um != shift_um else 0.0
        load_n, shift_um = load_n if step.load_n is None else step.load_n, step.shift_um
        moving = ramp_s > 0.0 or move_s > 0.0
        motion_s = max(ramp_s, move_s) + (plan.hold.settle_s if moving else 0.0)
        waited_s = 0.0 if plan.triggered else _until_next_scan(motion_s + plan.hold.hold_s, pace, first=not steps)
        steps.append(StepTime(step.step, step.phase, now_s, motion_s, plan.hold.hold_s, waited_s + pair_s))
        now_s = steps[-1].ends_s
        max_waiting_s += 0.0 if plan.adaptive_hold is None else plan.adaptive_hold.max_hold_s - plan.hold.hold_s
    max_waiting_s += 0.0 if plan.warm_up is None else plan.warm_up.max_wait_s
    scans = 2 * len(steps) if plan.triggered else round(now_s / pace.scan_s)
    return Schedule(tuple(steps), max_waiting_s, scans)


def _until_next_scan(rest_s: float, pace: TimingAssumptions, *, first: bool) -> float:
    """Return the time from the end of a hold to the begin of the first valid scan, s.

    A microscope that scans continuously began a scan when the second scan of the last pair ended, `export_s` before the end of the step.
    In the simulated experiment of 22 steps the time between pairs was 285.2 s; this function returns 284.0 s.
    """
    if first:
        return 0.5 * pace.scan_s
    since_s = pace.export_s + rest_s
    return math.ceil(since_s / pace.scan_s) * pace.scan_s - since_s


def dose_c_m2(scans: int, dwell_s: float, current_a: float, pixel_size_m: float) -> float:
    """Return the charge per area in the field of view, C/m^2.

    Args:
        scans: number of scans of the field.
        dwell_s: dwell time per pixel in one scan, including all integrations and passes, s.
        current_a: beam current, A.
        pixel_size_m: edge of a pixel on the specimen, m.
    """
    return scans * dwell_s * current_a / pixel_size_m**2
