"""Frame trigger of the SEM in separate threads, so that a trigger without an answer does not block the loop."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

from semlive.data.scan_report import ScanReport
from semlive.engine import Device, DeviceFault, Event
from semlive.errors import LinkError
from semlive.ports import ClockSource, Trigger


class TriggerLink:
    """Calls a trigger in separate daemon threads.

    Args:
        trigger: driver of the trigger.
        on_event: callback for the fault event of a failed trigger, in such a thread.
        clock: experiment time.
        on_report: callback for the settings of a scan, from triggers that read them, in such a thread.
    """

    def __init__(
        self,
        trigger: Trigger,
        on_event: Callable[[Event], None],
        clock: ClockSource,
        on_report: Callable[[ScanReport], None] = lambda report: None,
    ) -> None:
        self._trigger, self._on_event, self._clock, self._on_report = trigger, on_event, clock, on_report

    def request_scan(self) -> None:
        """Trigger one frame; returns at once."""
        threading.Thread(target=self._trigger_scan, name="trigger", daemon=True).start()

    def close(self, timeout_s: float = 2.0) -> None:
        """Close the link; never raises."""
        closing = threading.Thread(target=self._close, name="trigger closing", daemon=True)
        closing.start()
        closing.join(timeout_s)

    def _trigger_scan(self) -> None:
        report = None
        try:
            report = self._trigger.scan_once()
        except Exception as error:
            reason = str(error) if isinstance(error, LinkError) else f"the trigger's driver failed: {error!r}"
            # The loop may be closed; the event is then not needed.
            with contextlib.suppress(RuntimeError):
                self._on_event(DeviceFault(self._clock.now_ns(), Device.SEM, reason))
        if report is not None:
            with contextlib.suppress(RuntimeError):
                self._on_report(report)

    def _close(self) -> None:
        with contextlib.suppress(Exception):
            self._trigger.close()
