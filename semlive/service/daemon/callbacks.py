"""Callbacks of the folder watcher, the analysis process, drivers, loop and page into control and the log.

Theory of operation
-------------------
Watcher and analysis call from threads of their own; `Control.call_soon` passes each call to the loop, where the functions of this module
run. They never block. Only `BoundedHandoff` blocks the thread of the analysis, for at most a second, while the loop is behind.
"""

from __future__ import annotations

import contextlib
import threading
import traceback
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Generic, TypeVar

from semlive.data.faults import FaultCode
from semlive.engine import Device, DeviceFault, OperatorAction, OperatorCommand
from semlive.formats.log.messages import OperatorMessage
from semlive.ports import ClockSource, OperatorInterface, OperatorPrompt
from semlive.service.control.control import Control
from semlive.service.log.alarms import acknowledgements
from semlive.service.log.run_log import RunLog
from semlive.service.runtime.clock import SimulatedClock, SystemClock
from semlive.service.watch.thread import FolderWatcher
from semlive.service.watch.watch_settings import WatchSettings

T = TypeVar("T")
_MAX_PENDING = 64
_TIMEOUT_S = 1.0


class BoundedHandoff(Generic[T]):
    """Passes items to a loop in their order and blocks while too many of them are pending.

    When the analysis reports all pairs again, it sends thousands of messages at once. Unbounded, they used 1 kB for every pair of the run,
    and Python does not return such memory to the system.

    Args:
        call_soon: schedules a call in the loop, from any thread.
        consume: processes an item, in the loop.
        max_pending: largest number of pending items.
        timeout_s: longest wait, s; after it the item is passed on, because the loop is blocked or closed.
    """

    def __init__(
        self,
        call_soon: Callable[[Callable[[], None]], None],
        consume: Callable[[T], None],
        max_pending: int = _MAX_PENDING,
        timeout_s: float = _TIMEOUT_S,
    ) -> None:
        self._call_soon, self._consume, self._timeout_s = call_soon, consume, timeout_s
        self._capacity = threading.Semaphore(max_pending)

    def __call__(self, item: T) -> None:
        """Pass an item to the loop; to be called from one thread only."""
        acquired = self._capacity.acquire(timeout=self._timeout_s)

        def deliver() -> None:
            if acquired:
                self._capacity.release()
            self._consume(item)

        self._call_soon(deliver)


def folder_watcher(control: Control, clock: SystemClock | SimulatedClock, watch: WatchSettings, journal: RunLog) -> FolderWatcher:
    """Return the watcher of the export folder, which is not started; its files go to the log, its faults to control."""
    monitor = control.monitor
    watcher = FolderWatcher(
        watch,
        clock,
        lambda file: control.call_soon(journal.file, file),
        lambda rejected: control.call_soon(monitor.on_file_refused, rejected.name, rejected.reason),
        lambda what: control.call_soon(monitor.trouble, what, "export folder", "kept trying"),
        lambda what: control.call_soon(monitor.on_notice, what),
        lambda what: control.call_soon(_folder_replaced, control, clock, what),
    )
    control.operator.accept_folder = watcher.accept
    return watcher


def _folder_replaced(control: Control, clock: SystemClock | SimulatedClock, message: str) -> None:
    """Pause the run because the export folder was replaced by another folder; the operator must resume."""
    control.monitor.trouble(message, "export folder", "paused the run; nothing is taken from this folder", FaultCode.EXPORT_FOLDER)
    control.engine.handle(OperatorAction(clock.now_ns(), OperatorCommand.PAUSE, message))
    control.monitor.troubled.set()


def analysis_trouble(control: Control, clock: SystemClock | SimulatedClock) -> Callable[[str, bool], None]:
    """Return the callback for a crash or hang of the analysis process: a message, and whether the process is lost permanently."""

    def report(message: str, lost: bool) -> None:
        control.monitor.trouble(message, "analysis", "stopped" if lost else "started another that catches up from the log")
        if lost:
            control.engine.handle(DeviceFault(clock.now_ns(), Device.SEM, "the analysis process is lost, so frames cannot be judged"))

    return lambda message, lost: control.call_soon(report, message, lost)


class OperatorPrompts:
    """All operator interfaces of a run. The name of a question is its interface and its number there, as in ``terminal.3``.

    Args:
        interfaces: operator interfaces by name.
        clock: experiment time.
        record: writes a message to the log; called in the thread of the prompt.
    """

    def __init__(
        self, interfaces: Mapping[str, OperatorInterface], clock: ClockSource, record: Callable[[OperatorMessage], object]
    ) -> None:
        self._interfaces, self._clock, self._record = interfaces, clock, record
        for name, interface in interfaces.items():
            interface.subscribe(partial(self._on_prompt, name))

    def answer(self, question: str, line: str) -> bool:
        """Answer a question; False if it is not open. May block as long as a terminal does."""
        name, _, number = question.rpartition(".")
        interface = self._interfaces.get(name)
        return interface is not None and number.isdecimal() and interface.answer(int(number), line)

    def close(self) -> None:
        """Unsubscribe from all interfaces."""
        for interface in self._interfaces.values():
            interface.subscribe(lambda _: None)

    def _on_prompt(self, name: str, prompt: OperatorPrompt) -> None:
        arguments = {} if prompt.question is None else {"question": f"{name}.{prompt.question}", "wanted": prompt.response_type.value}
        # The loop may be closed; the message is then not needed.
        with contextlib.suppress(RuntimeError):
            self._record(OperatorMessage(time_ns=self._clock.now_ns(), what=prompt.kind, args={"text": prompt.text, **arguments}))


def acknowledger(journal: RunLog, clock: SystemClock | SimulatedClock) -> Callable[[str | None, str], bool]:
    """Return the callback for the acknowledgement of an alarm, or of all (None), with its origin.

    No device moves. The callback returns whether any of the alarms was unacknowledged.
    """

    def acknowledge(alarm: str | None, by: str) -> bool:
        messages = acknowledgements(journal.alarms, alarm, by, clock.now_ns())
        for message in messages:
            journal.write_message(message)
        return bool(messages)

    return acknowledge


def loop_error_handler(control: Control, journal: RunLog, clock: SystemClock | SimulatedClock) -> Callable[[object, dict[str, Any]], None]:
    """Return the exception handler of the loop, which writes to the log instead of the terminal."""
    return lambda _loop, context: control.call_soon(log_loop_error, journal, clock, context)


def log_loop_error(journal: RunLog, clock: SystemClock | SimulatedClock, context: dict[str, Any]) -> None:
    """Write an error that asyncio would print to the log instead of the terminal."""
    error = context.get("exception")
    trace = "".join(traceback.format_exception(error)) if isinstance(error, BaseException) else ""
    journal.write_text(clock.now_ns(), f"{trace}{context.get('message', '')}", "error")
