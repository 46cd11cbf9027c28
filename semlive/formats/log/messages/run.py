"""Messages about the run: start, clock, transitions, commands, faults, operator."""

from __future__ import annotations

from typing import Any

from pydantic import JsonValue, model_validator

from semlive.data.faults import fault_kind
from semlive.formats.log.messages.base import Message, MonotonicStamped, Point
from semlive.formats.log.messages.devices import LoadSampleMessage, StageSampleMessage


class RunMessage(Message):
    """`/run`: a run began, or was resumed in the next segment.

    Attributes:
        run: name of the run.
        segment: number of this segment.
        started_time_ns: experiment time of the start, UTC ns.
        started_mono_ns: monotonic clock at that instant.
        boot_id: identity of the boot that the monotonic clock belongs to; empty if unknown.
        host: name of the computer.
        versions: of semlive, python, numpy, numba, ... and the `commit` of semlive, if it is known.
        config: the checked configuration.
    """

    run: str
    segment: int = 0
    started_time_ns: int
    started_mono_ns: int = 0
    boot_id: str = ""
    host: str
    versions: dict[str, str]
    config: dict[str, JsonValue]


class SnapshotMessage(Message):
    """`/snapshot`: state of a run when it was resumed; the configuration is in the preceding `/run`.

    The estimate is not repeated here: the pairs and disparity maps of the earlier segments are exact and reproduce it to the
    last bit. `inputs` and `outputs` are the progress of the analysis.

    Attributes:
        segment: number of this segment.
        time_ns: experiment time.
        interrupted_time_ns: log time of the last message before the interruption.
        interrupted_boot_id: identity of the boot of the computer at that time.
        state: state of the protocol at the interruption.
        next_step: index of the step that is entered again, or the number of steps if all are done.
        pairs: number of valid pairs.
        exports: exported files so far; the next one has this number.
        origin_um: reading of the stage when the run began, None without a stage.
        load: last reading of the load frame.
        stage: last reading of the stage.
        inputs: number of messages that were passed to the analysis.
        outputs: number of messages of the analysis in the log.
        revision: of the last estimate in the log, 0 if there is none.
        pairs_analysed: number of pairs of that estimate.
        damage: unreadable parts of the earlier segments, one sentence each.
    """

    segment: int
    time_ns: int
    interrupted_time_ns: int
    interrupted_boot_id: str
    state: str
    next_step: int
    pairs: int
    exports: int
    origin_um: Point | None
    load: LoadSampleMessage | None
    stage: StageSampleMessage | None
    inputs: int
    outputs: int
    revision: int
    damage: tuple[str, ...]
    pairs_analysed: int = 0


class ClockMessage(MonotonicStamped):
    """`/clock`: parameters of experiment time, valid from this message on (see `semlive.data.clock`)."""

    utc0_ns: int
    mono0_ns: int
    rate: float
    revision: int
    reason: str


class ClockOffsetMessage(Message):
    """`/clock/offset`: offset of the clock of another computer from experiment time (see `semlive.data.clock`).

    Attributes:
        clock: ``sem``, the computer that writes the time into the files, or ``share``, the computer that sets their modification times.
        offset_s: that clock minus experiment time.
        sigma_s: standard uncertainty.
        files: number of files that the estimate uses.
        export: number of the newest of these files; None if the offset was measured without exported files.
        reason: why the message was written, one sentence.
        advice: what to do if frames get a wrong scan time from this clock; empty if nothing.
    """

    clock: str
    offset_s: float
    sigma_s: float
    files: int
    export: int | None
    reason: str
    advice: str = ""


class StateMessage(MonotonicStamped):
    """`/state`: a transition of the engine, with its cause and the values that the decision used.

    Attributes:
        time_ns: experiment time.
        before: state before the transition.
        after: state after the transition.
        cause: cause of the transition.
        step: index of the step; None without a step.
        guards: the values that the decision used, by name.
        late_s: in a transition to imaging, time from the end of the hold to its detection, s. In older logs only `guards` has it.
    """

    time_ns: int
    before: str
    after: str
    cause: str
    step: int | None
    guards: dict[str, JsonValue]
    late_s: float = 0.0

    @model_validator(mode="before")
    @classmethod
    def _late_s_of_older_logs(cls, values: Any) -> Any:
        late_s = values.get("guards", {}).get("late_s") if isinstance(values, dict) else None
        return {"late_s": late_s, **values} if isinstance(late_s, int | float) else values


class CommandMessage(MonotonicStamped):
    """`/command`: a command to a device, and its result."""

    time_ns: int
    what: str
    args: dict[str, JsonValue]
    result: str


class FaultMessage(MonotonicStamped):
    """`/fault`: a fault.

    Attributes:
        time_ns: experiment time.
        what: description.
        where: component or pair that the fault concerns.
        action: reaction of semlive.
        code: a `FaultCode`; empty in older logs.
        kind: a `FaultKind`; without one, that of `where`; empty if there is none.
    """

    time_ns: int
    what: str
    where: str
    action: str
    code: str = ""
    kind: str = ""

    @model_validator(mode="before")
    @classmethod
    def _kind_of_where(cls, values: Any) -> Any:
        where = values.get("where") if isinstance(values, dict) else None
        return {"kind": fault_kind(where) or "", **values} if isinstance(where, str) else values


class OperatorMessage(MonotonicStamped):
    """`/operator`: a prompt to the operator, or an answer or command of the operator."""

    time_ns: int
    what: str
    args: dict[str, JsonValue]
