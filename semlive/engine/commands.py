"""What the engine wants done, in order, by the shell."""

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
        before: the state that was left.
        cause: why.
        after: the state that was entered; may be the same.
        step: index of the step.
        details: the values that decided, by name.
        code: the kind of fault, where the state that was entered is one.
    """

    time_ns: int
    before: State
    cause: Cause
    after: State
    step: int
    details: tuple[Guard, ...] = ()
    code: FaultCode | None = None


@dataclass(frozen=True, slots=True)
class RampTo:
    """Go to a load at a rate.

    Attributes:
        force_n: target, tension positive.
        rate_n_s: change of load, > 0.
        tolerance_n: allowed distance of the load from its target; the link thread stops a ramp that goes further beyond.
    """

    force_n: float
    rate_n_s: float
    tolerance_n: float = 10.0


@dataclass(frozen=True, slots=True)
class MoveStage:
    """Go to a position in the stage's own coordinates."""

    x_um: float
    y_um: float


@dataclass(frozen=True, slots=True)
class StopMotion:
    """Stop every device and hold position."""

    reason: str


@dataclass(frozen=True, slots=True)
class TriggerFrame:
    """Ask the SEM for one frame."""


@dataclass(frozen=True, slots=True)
class AcceptPair:
    """Two exported frames are the pair of the step."""

    decision: PairDecision


@dataclass(frozen=True, slots=True)
class RejectFrame:
    """An exported file is not part of a pair, and why (one sentence)."""

    export: int
    reason: str


@dataclass(frozen=True, slots=True)
class Notify:
    """Tell the operator one sentence."""

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
