"""Execution of the commands of the engine: each is written to the log and passed to the device, the trigger or the log.

Theory of operation
-------------------
All methods run in the loop of control. Nothing blocks: links and trigger queue an order for threads of their own. The engine only
commands devices whose link is open, so the link of a commanded device always exists.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from semlive.data.scan_report import ScanReport
from semlive.engine import (
    AcceptPair,
    Command,
    Device,
    FinishRun,
    MoveStage,
    Notify,
    RampTo,
    RejectFrame,
    StopMotion,
    Transition,
    TriggerFrame,
)
from semlive.formats.log.conversions import trigger_message
from semlive.ports import ClockSource
from semlive.service.device_link import DeviceLink
from semlive.service.device_link.trigger import TriggerLink
from semlive.service.log.run_log import RunLog


class CommandDispatcher:
    """Devices of a run, and the execution of engine commands; belongs to the running loop.

    Args:
        journal: the log of the run.
        clock: experiment time.
    """

    def __init__(self, journal: RunLog, clock: ClockSource) -> None:
        self._journal, self._clock = journal, clock
        self.links: Mapping[Device, DeviceLink] = {}
        self._trigger: TriggerLink | None = None
        self.fault_code = ""
        """Code of the latest transition, a `FaultCode`; empty if it is no fault."""
        self.finished: asyncio.Future[FinishRun] = asyncio.get_running_loop().create_future()
        """Result of the protocol."""

    def connect(self, links: Mapping[Device, DeviceLink], trigger: TriggerLink | None) -> None:
        """Set the links and the trigger that execute commands."""
        self.links, self._trigger = links, trigger

    def stop_all(self, reason: str) -> None:
        """Stop all devices; returns at once."""
        for link in self.links.values():
            link.stop(reason)

    def log_scan(self, report: ScanReport) -> None:
        """Log the settings of a triggered scan."""
        self._journal.write_message(trigger_message(report))

    def execute(self, command: Command) -> None:
        """Log a command of the engine and pass it on."""
        now_ns = self._clock.now_ns()
        if isinstance(command, Transition):
            self._journal.transition(command)
            self.fault_code = "" if command.code is None else command.code
        elif isinstance(command, RampTo):
            self._journal.command(now_ns, "ramp_to", {"force_n": command.force_n, "rate_n_s": command.rate_n_s}, "sent")
            self.links[Device.LOAD_FRAME].send(command)
        elif isinstance(command, MoveStage):
            moves = self.links[Device.STAGE].stage_kind or "unknown"
            self._journal.command(now_ns, "move_stage", {"x_um": command.x_um, "y_um": command.y_um, "moves": moves}, "sent")
            self.links[Device.STAGE].send(command)
        elif isinstance(command, StopMotion):
            self.stop_all(command.reason)
            self._journal.command(now_ns, "stop", {"reason": command.reason}, "sent")
        elif isinstance(command, TriggerFrame):
            self._journal.command(now_ns, "trigger", {}, "sent")
            if self._trigger is not None:
                self._trigger.request_scan()
        elif isinstance(command, AcceptPair):
            self._journal.pair(command.decision)
        elif isinstance(command, RejectFrame):
            self._journal.refused_file(command.export, "", command.reason, now_ns)
        elif isinstance(command, Notify):
            self._journal.write_text(now_ns, command.text)
        elif not self.finished.done():
            self._journal.write_text(now_ns, command.text)
            self.finished.set_result(command)
