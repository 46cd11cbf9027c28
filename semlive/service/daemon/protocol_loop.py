"""The loop of a run: ticks and commands until the protocol ends, then the wait for the analysis of the last pairs.

Theory of operation
-------------------
Both coroutines tick control every `TICK_S` and block only in `asyncio.sleep`. The protocol begins when the analysis is ready. Commands of
the operator come from a queue that any thread fills.
"""

from __future__ import annotations

import asyncio
import queue
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from semlive.data.loading import DeviceIdentity
from semlive.engine import Device, DeviceFault, FinishRun, OperatorCommand
from semlive.errors import SemliveError
from semlive.ports import ClockSource
from semlive.service.analysis.process import AnalysisProcess
from semlive.service.control.control import Control
from semlive.service.daemon.devices import TICK_S
from semlive.service.log.alarms import AcknowledgeAll
from semlive.service.watch.thread import FolderWatcher

# Longest time without a result while the remaining pairs are analysed after the end of the protocol. Results are seconds apart, or the
# start-up time of a new child process; the conclusion of 22 pairs took two minutes on a busy computer.
_NO_RESULT_S = 300.0
# Compiling for the first time takes half a minute on 2 cores.
_READY_TIMEOUT_S = 300.0
# The pairs of a resumed run are first correlated again: at 16 million pixels a pair takes some seconds.
_READY_TIMEOUT_PER_PAIR_S = 20.0


@dataclass(frozen=True, slots=True)
class ProtocolLoop:
    """Loop from the open devices to the end of the protocol.

    Attributes:
        control: control of the run.
        clock: experiment time.
        watcher: watcher of the export folder, started with the protocol.
        identities: identities of the open devices.
        commands: queue of commands of the operator.
        acknowledge: acknowledges an alarm, or all (None), with its origin.
        stop_on_fault: end the run at a fault instead of waiting for the operator.
        on_start: called when the protocol begins.
    """

    control: Control
    clock: ClockSource
    watcher: FolderWatcher
    identities: Mapping[Device, DeviceIdentity]
    commands: queue.SimpleQueue[OperatorCommand | AcknowledgeAll]
    acknowledge: Callable[[str | None, str], bool]
    stop_on_fault: bool
    on_start: Callable[[], None]

    async def run(self) -> FinishRun:
        """Run the protocol to its end.

        Raises:
            SemliveError: the analysis was not ready in time.
        """
        control, started, watch_failed = self.control, False, False
        finished, troubled = control.dispatcher.finished, control.monitor.troubled
        ready_in_s = _READY_TIMEOUT_S + _READY_TIMEOUT_PER_PAIR_S * control.pairs_done
        ready_by = time.monotonic() + ready_in_s
        while not finished.done():
            self._execute_commands()
            if not started and control.analysis.ready.is_set():
                started = True
                self.on_start()
                self.watcher.start()
                control.ready(self.identities.get(Device.LOAD_FRAME), self.identities.get(Device.STAGE))
            elif not started and time.monotonic() > ready_by:
                raise SemliveError(f"the analysis process was not ready within {ready_in_s:g} s; run again on an idle computer")
            if self.watcher.failed and not watch_failed:
                watch_failed = True
                control.engine.handle(DeviceFault(self.clock.now_ns(), Device.SEM, "the export folder is not watched any more"))
            control.tick()
            if troubled.is_set() and self.stop_on_fault:
                troubled.clear()
                control.operator.execute(OperatorCommand.STOP)
            await asyncio.sleep(TICK_S)
        return finished.result()

    def _execute_commands(self) -> None:
        while not self.commands.empty():
            request = self.commands.get()
            if isinstance(request, OperatorCommand):
                self.control.operator.execute(request)
            else:
                self.acknowledge(None, request.by)


async def drain_analysis(control: Control, analysis: AnalysisProcess, stopped: bool, skip: Callable[[], bool]) -> bool:
    """Wait for the analysis of the last pairs, until the operator cancels the wait by a signal.

    Args:
        control: control of the run.
        analysis: the analysis process.
        stopped: the run was stopped before its end.
        skip: whether the operator has cancelled the wait.

    Returns:
        Whether all pairs are analysed.
    """
    closing = asyncio.get_running_loop().run_in_executor(None, analysis.drain, _NO_RESULT_S, stopped)
    while not closing.done():
        control.tick()
        if skip():
            analysis.kill()
        await asyncio.sleep(TICK_S)
    # The last messages of the analysis are ahead of this in the queue of the loop.
    await asyncio.sleep(0)
    return closing.result()
