"""How long an experiment is going to take, before it is run."""

from __future__ import annotations

import math
from dataclasses import dataclass

from semlive.data.experiment import Phase, Plan


@dataclass(frozen=True, slots=True)
class TimingAssumptions:
    """What takes time besides the plan itself.

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
        step: its number.
        phase: what its pair is for.
        begins_s: after the begin of the run.
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
        """After the begin of the run."""
        return self.begins_s + self.motion_s + self.hold_s + self.imaging_s


@dataclass(frozen=True, slots=True)
class Schedule:
    """A whole experiment's expected times.

    Attributes:
        steps: in order.
        max_waiting_s: what waiting for drift and relaxation may add at most.
        scans: how often the field is scanned: every frame that is exported, or the two of each pair where frames are triggered.
    """

    steps: tuple[StepTime, ...]
    max_waiting_s: float
    scans: int

    @property
    def duration_s(self) -> float:
        """From the begin to the end of the last pair, nothing being waited for."""
        return self.steps[-1].ends_s if self.steps else 0.0

    @property
    def pair_frames(self) -> int:
        """Frames that are analysed."""
        return 2 * len(self.steps)


def schedule(plan: Plan, pace: TimingAssumptions) -> Schedule:
    """Expected times of every step.

    Args:
        plan: the experiment.
        pace: what takes time besides.
    """
    # A triggered frame is asked for when the one before is complete; without a trigger the next scan follows at once.
    pair_s = 2.0 * pace.scan_s + pace.export_s + (pace.export_s if plan.triggered else 0.0)
    steps: list[StepTime] = []
    load_n, shift_um, now_s, most_s = 0.0, (0.0, 0.0), 0.0, 0.0
    for step in plan.steps:
        ramp_s = 0.0 if step.load_n is None else abs(step.load_n - load_n) / plan.ramp_rate_n_s
        move_s = pace.move_s if step.shift_um != shift_um else 0.0
        load_n, shift_um = load_n if step.load_n is None else step.load_n, step.shift_um
        moving = ramp_s > 0.0 or move_s > 0.0
        motion_s = max(ramp_s, move_s) + (plan.hold.settle_s if moving else 0.0)
        waited_s = 0.0 if plan.triggered else _until_next_scan(motion_s + plan.hold.hold_s, pace, first=not steps)
        steps.append(StepTime(step.step, step.phase, now_s, motion_s, plan.hold.hold_s, waited_s + pair_s))
        now_s = steps[-1].ends_s
        most_s += 0.0 if plan.adaptive_hold is None else plan.adaptive_hold.max_hold_s - plan.hold.hold_s
    most_s += 0.0 if plan.warm_up is None else plan.warm_up.max_wait_s
    scans = 2 * len(steps) if plan.triggered else round(now_s / pace.scan_s)
    return Schedule(tuple(steps), most_s, scans)


def _until_next_scan(rest_s: float, pace: TimingAssumptions, *, first: bool) -> float:
    """From the end of a hold to the begin of the first scan that counts, which must begin after it.

    A microscope that scans all the time began one when the last pair's second scan ended, `export_s` before the step did. In the
    simulated experiment of 22 steps a pair followed the other after 285.2 s; this says 284.0.
    """
    if first:
        return 0.5 * pace.scan_s
    since_s = pace.export_s + rest_s
    return math.ceil(since_s / pace.scan_s) * pace.scan_s - since_s


def dose_c_m2(scans: int, dwell_s: float, current_a: float, pixel_size_m: float) -> float:
    """Charge that every place of the field gets, in C/m^2.

    Args:
        scans: of the field.
        dwell_s: on each pixel in one scan, all integrations and passes included.
        current_a: of the beam.
        pixel_size_m: edge of a pixel on the specimen.
    """
    return scans * dwell_s * current_a / pixel_size_m**2
