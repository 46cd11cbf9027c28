"""Remaining time of a run, for display: the planned durations of its steps, scaled by the measured durations of the completed steps.

The remaining time decreases only while the protocol works. A paused run repeats its step, so the time of the interrupted step does not
count. A step that takes longer than expected does not reduce the time of later steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from semlive.data.experiment import Plan
from semlive.engine import State
from semlive.engine.schedule import TimingAssumptions, schedule

WORKING_STATES = frozenset(
    (State.RAMPING, State.SETTLING, State.HOLDING, State.IMAGING, State.STEP_DONE, State.CALIBRATION_GATE, State.WARM_UP)
)
"""States in which the remaining time decreases."""


@dataclass(frozen=True, slots=True)
class RunProgress:
    """Working time of a run so far. Times are seconds after the start of the run.

    Attributes:
        plan: planned experiment; None if unknown.
        scan_s: duration of one scan, s; None before the first file.
        done: number of completed steps of the plan.
        working: whether the protocol works.
        since_s: time of the last transition or completed pair.
        elapsed_s: working time in the current step until `since_s`, s.
        measured_s: working time of the measured completed steps, s.
        measured_steps: numbers of these steps.
    """

    plan: Plan | None = None
    scan_s: float | None = None
    done: int = 0
    working: bool = False
    since_s: float = 0.0
    elapsed_s: float = 0.0
    measured_s: float = 0.0
    measured_steps: tuple[int, ...] = ()

    def expected_s(self) -> tuple[float, ...]:
        """Return the expected working time of each step, s; empty if plan or scan time is unknown."""
        if self.plan is None or self.scan_s is None:
            return ()
        steps = schedule(self.plan, TimingAssumptions(self.scan_s)).steps
        planned_s = [step.ends_s - step.begins_s for step in steps]
        reference_s = sum(planned_s[step] for step in self.measured_steps if step < len(planned_s))
        factor = self.measured_s / reference_s if reference_s > 0.0 else 1.0
        return tuple(factor * step_s for step_s in planned_s)

    def shown(self) -> dict[str, float | bool | None]:
        """Return the values that the page shows.

        Returns:
            ``remaining_s``: remaining time at ``since_s``, None if unknown; ``floor_s``: remaining time at the end of the current step;
            ``working``: whether the remaining time decreases.
        """
        expected_s = self.expected_s()
        if not expected_s:
            return {"remaining_s": None, "floor_s": None, "since_s": self.since_s, "working": self.working}
        floor_s = sum(expected_s[self.done + 1 :])
        remaining_s = max(floor_s, sum(expected_s[self.done :]) - self.elapsed_s)
        return {"remaining_s": round(remaining_s, 1), "floor_s": round(floor_s, 1), "since_s": self.since_s, "working": self.working}


def with_plan(progress: RunProgress, plan: Plan | None, last_s: float) -> RunProgress:
    """Return the progress after the start of a daemon: nothing works until its first transition."""
    return replace(progress, plan=plan, working=False, since_s=last_s, elapsed_s=0.0)


def with_state(progress: RunProgress, state: str, time_s: float) -> RunProgress:
    """Return the progress after a transition."""
    working = state in WORKING_STATES
    elapsed_s = progress.elapsed_s + time_s - progress.since_s if progress.working else 0.0
    return replace(progress, working=working, since_s=time_s, elapsed_s=elapsed_s if working else 0.0)


def with_pair(progress: RunProgress, done: int, time_s: float) -> RunProgress:
    """Return the progress after a completed pair.

    Args:
        progress: progress so far.
        done: number of completed steps of the plan, with this one; unchanged after an additional pair of the warm-up gate.
        time_s: time of completion.
    """
    elapsed_s = progress.elapsed_s + (time_s - progress.since_s if progress.working else 0.0)
    progress = replace(progress, since_s=time_s, elapsed_s=0.0)
    if done == progress.done or not progress.working:
        return replace(progress, done=done)
    steps = (*progress.measured_steps, done - 1)
    return replace(progress, done=done, measured_s=progress.measured_s + elapsed_s, measured_steps=steps)
