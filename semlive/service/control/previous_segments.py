"""State of an interrupted run, as its log segments hold it: the input of control, clock and recorder of the resumed run."""

from __future__ import annotations

from dataclasses import dataclass, field

from semlive.data.clock import Clock
from semlive.engine import InterruptedRun
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import SnapshotMessage
from semlive.service.log.alarms import Alarms


@dataclass(frozen=True, slots=True)
class PreviousSegments:
    """State of a run from its earlier segments.

    Attributes:
        segment: number of the next segment.
        interrupted_run: state of the run for the engine.
        state: state of the protocol at the interruption.
        boot_id: boot of the computer at the interruption.
        clock: the last linear relation of experiment time to the monotonic clock; None if there is none.
        last_log_time_ns: log time of the last message.
        exports: number of the next exported file.
        inputs: number of messages that the analysis has received.
        outputs: number of messages of the analysis in the log.
        revision: revision of the last estimate in the log; 0 if there is none.
        pairs_analysed: number of pairs in that estimate.
        damage: damaged parts of the log, one sentence each.
        alarms: alarms of the earlier segments.
    """

    segment: int
    interrupted_run: InterruptedRun
    state: str
    boot_id: str
    clock: Clock | None
    last_log_time_ns: int
    exports: int
    inputs: int
    outputs: int
    revision: int
    pairs_analysed: int
    damage: tuple[str, ...]
    alarms: Alarms = field(default_factory=Alarms)

    def clock_line(self, boot_id: str) -> Clock | None:
        """Return the clock relation to continue with; None after a reboot of the computer."""
        return self.clock if boot_id and boot_id == self.boot_id else None

    def snapshot(self, time_ns: int) -> SnapshotMessage:
        """Return the first message of the next segment."""
        interrupted_run, boot = self.interrupted_run, {"boot_id": self.boot_id}
        return SnapshotMessage(
            segment=self.segment,
            time_ns=time_ns,
            interrupted_time_ns=self.last_log_time_ns,
            interrupted_boot_id=self.boot_id,
            state=self.state,
            next_step=len(interrupted_run.completed_pairs),
            pairs=len(interrupted_run.completed_pairs),
            exports=self.exports,
            origin_um=interrupted_run.origin_um,
            load=None if interrupted_run.load is None else values.load_sample_message(interrupted_run.load).model_copy(update=boot),
            stage=None
            if interrupted_run.position is None
            else values.stage_sample_message(interrupted_run.position).model_copy(update=boot),
            inputs=self.inputs,
            outputs=self.outputs,
            revision=self.revision,
            pairs_analysed=self.pairs_analysed,
            damage=self.damage,
        )
