"""Context of one engine step, which makes all state changes and collects all commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TypedDict, Unpack

from semlive.data.experiment import Limits, Plan
from semlive.data.faults import FaultCode
from semlive.data.frame import FrameInfo
from semlive.engine.commands import Command, FinishRun, Guard, Notify, RejectFrame, StopMotion, Transition
from semlive.engine.events import Device
from semlive.engine.resume import InterruptedRun
from semlive.engine.state import AnalysisResults, Devices, EngineState, Gates, HoldProgress, Imaging, MotionProgress
from semlive.engine.states import FINAL_STATES, TRANSITIONS, Cause, next_state

FAULT_OF_CAUSE: Mapping[str, FaultCode] = MappingProxyType(
    {
        Cause.LIMIT: FaultCode.LIMIT,
        Cause.LINK_LOST: FaultCode.LINK_LOST,
        Cause.DEVICE_FAULT: FaultCode.DEVICE_FAULT,
        Cause.DEVICE_STOPPED: FaultCode.DEVICE_FAULT,
        Cause.NOT_REACHED: FaultCode.NOT_REACHED,
        Cause.MOTION_TIMEOUT: FaultCode.MOTION_TIMEOUT,
        Cause.FRAME_TIMEOUT: FaultCode.FRAME_TIMEOUT,
        Cause.EMERGENCY: FaultCode.EMERGENCY_STOP,
    }
)
"""Default fault code of each cause."""


class StateChanges(TypedDict, total=False):
    """Fields of `EngineState` that `StepContext.update` may replace: all but the state of the run and its times."""

    plan: Plan
    limits: Limits
    step_index: int
    devices: Devices
    motion: MotionProgress
    hold: HoldProgress
    imaging: Imaging
    analysis: AnalysisResults
    gates: Gates
    interrupted_run: InterruptedRun | None
    message: str


@dataclass(slots=True)
class StepContext:
    """Context of one call of `step`: the changing state and the commands so far."""

    state: EngineState
    commands: list[Command] = field(default_factory=list)

    def update(self, **changes: Unpack[StateChanges]) -> None:
        """Replace parts of the state; the state of the run itself changes only by `transition`."""
        if "state" in changes:
            raise TypeError("the state of a run changes by transition()")
        self.state = replace(self.state, **changes)

    def is_allowed(self, cause: Cause) -> bool:
        """Whether the table lists `cause` here."""
        return (self.state.state, cause) in TRANSITIONS

    def transition(self, cause: Cause, *guards: Guard, code: FaultCode | None = None, late_s: float = 0.0) -> None:
        """Change state by the table.

        Args:
            cause: cause of the transition.
            guards: the values that caused it, by name.
            code: kind of the fault, if it is a fault.
            late_s: time from the condition of the transition to its detection, s.

        Raises:
            InvalidTransition: if the table does not list it.
        """
        before = self.state
        after = next_state(before.state, cause)
        self.commands.append(Transition(before.time_ns, before.state, cause, after, before.step_index, guards, code, late_s))
        self.state = replace(before, state=after, since_ns=before.time_ns)

    def accept_first_frame(self, info: FrameInfo) -> None:
        """Store the first frame of a pair; the frame timeout starts again."""
        self.state = replace(self.state, imaging=replace(self.state.imaging, first=info), since_ns=self.state.time_ns)

    def announce(self, text: str) -> None:
        """Show a message to the operator."""
        self.commands.append(Notify(text))
        self.update(message=text)

    def discard_frames(self, reason: str) -> None:
        """Reject the first frame of the pair and all pending frames."""
        imaging = self.state.imaging
        discarded = (() if imaging.first is None else (imaging.first,)) + tuple(frame.info for frame in imaging.pending)
        self.commands.extend(RejectFrame(info.export, f"{info.name} is not used: {reason}") for info in discarded)
        self.update(imaging=replace(imaging, first=None, pending=()))

    def stop_and_transition(self, cause: Cause, reason: str, *guards: Guard, code: FaultCode | None = None) -> None:
        """Order all devices to stop, then change state; the reached load, and the reached shift of a moving stage, become unknown."""
        self.commands.append(StopMotion(reason))
        self.discard_frames(reason)
        hold = self.state.hold
        stage_moving = Device.STAGE in self.state.motion.pending_devices[:1]
        reached_shift_um = None if stage_moving else hold.reached_shift_um
        self.update(
            motion=MotionProgress(),
            hold=replace(hold, reached_load_n=None, in_tolerance_since_ns=None, reached_shift_um=reached_shift_um),
        )
        self.transition(cause, *guards, code=code)
        self.announce(reason)

    def fault(self, cause: Cause, reason: str, *guards: Guard, code: FaultCode | None = None) -> None:
        """Stop and go to FAULT if the table lists `cause` here; else only announce the reason. Without `code` the cause determines it."""
        if self.is_allowed(cause):
            self.stop_and_transition(cause, reason, *guards, code=code or FAULT_OF_CAUSE[cause])
        elif self.state.state not in FINAL_STATES and reason != self.state.message:
            self.announce(reason)

    def finish(self, cause: Cause, text: str) -> None:
        """End the run."""
        self.transition(cause)
        self.announce(text)
        self.commands.append(FinishRun(self.state.state, text))
