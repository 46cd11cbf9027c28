"""Commands of the engine, which the shell executes in order."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.data.faults import FaultCode
from semlive.data.pair import PairDecision
from semlive.engine.states import Cause, State

Guard = tuple[str, float | int | str]


@dataclass(frozen=True, slots=True)
class Transition:
    """The state changed: record it.

    Attributes:
        time_ns: experiment time.
        before: state before the transition.
        cause: cause of the transition.
        after: state after the transition; may be the same.
        step: index of the step.
        details: the values that caused the transition, by name.
        code: kind of the fault if `after` is a fault state, else None.
        late_s: in a transition to IMAGING, time from the end of the hold to its detection, s; scans that begin after the hold are valid.
    """

    time_ns: int
    before: State
    cause: Cause
    after: State
    step: int
    details: tuple[Guard, ...] = ()
    code: FaultCode | None = None
    late_s: float = 0.0


@dataclass(frozen=True, slots=True)
class RampTo:
    """Ramp the load to a target at a rate.

    Attributes:
        force_n: target, tension positive.
        rate_n_s: change of load, > 0.
        tolerance_n: allowed distance of the load from its target, N; the link thread stops a ramp that overshoots by more.
    """

    force_n: float
    rate_n_s: float
    tolerance_n: float = 10.0


@dataclass(frozen=True, slots=True)
class MoveStage:
    """Move the stage to a position in its own coordinates, um."""

    x_um: float
    y_um: float


@dataclass(frozen=True, slots=True)
class StopMotion:
    """Stop every device and hold position."""

    reason: str


@dataclass(frozen=True, slots=True)
class TriggerFrame:
    """Trigger one frame at the SEM."""


@dataclass(frozen=True, slots=True)
class AcceptPair:
    """Two exported frames are the pair of the step."""

    decision: PairDecision


@dataclass(frozen=True, slots=True)
class RejectFrame:
    """Reject an exported file; `reason` is one sentence."""

    export: int
    reason: str


@dataclass(frozen=True, slots=True)
class Notify:
    """Show one sentence to the operator."""

    text: str


@dataclass(frozen=True, slots=True)
class FinishRun:
    """The run is over.

    Attributes:
        outcome: COMPLETE or ABORTED.
        text: one sentence.
    """

    outcome: State
    text: str


Command = Transition | RampTo | MoveStage | StopMotion | TriggerFrame | AcceptPair | RejectFrame | Notify | FinishRun
