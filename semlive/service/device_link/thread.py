"""The link thread. Only this thread calls the driver, and it stops the device without a command if necessary.

Theory of operation
-------------------
Order of precedence in every cycle: the dead-man timeout, a pending stop, orders, the next reading. A call of the driver blocks for at most
the timeout of the driver, so a stop waits for at most one answer. The thread never begins a motion without an order.

After a stop, the stop is repeated until the readings show that the device is at rest (`stop_pursuit`). If a request fails while the
device may move, the stop is first written without waiting for an answer, on the old connection and on a new one, repeatedly until a link is
open. Only then is a reading requested: a device may execute orders that it cannot answer.

Control calls `LinkRequests` and reads results; the thread calls control back through the events of `StoppableDevice.emit`.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

from semlive.data.faults import FaultCode
from semlive.engine.events import CommandAcknowledged, DeviceFault, DeviceStopped
from semlive.ports import ClockSource
from semlive.service.device_link.monitors import DeadManSwitch
from semlive.service.device_link.polling import SamplePolling
from semlive.service.device_link.ports import Port
from semlive.service.device_link.requests import MAX_SLEEP_S, LinkRequests
from semlive.service.device_link.stopping import StoppableDevice
from semlive.service.runtime.pause import pause

# While a link is closed: longest time of repeated stops, longest time without a reading, and polling interval. A reading over a slow
# gateway takes a second, and three readings show rest.
_CLOSE_PURSUIT_S = 10.0
_CLOSE_SILENCE_S = 4.0
_CLOSE_POLL_S = 0.05


class LinkThread:
    """Body of the link thread, from opening to closing.

    Args:
        device: the device, whose link is not open.
        requests: requests of control.
        polling: readings of the device.
        clock: experiment time and the monotonic clock.
        dead_man_s: longest wall time between keep-alive signals, s; beyond it the device is stopped.
    """

    def __init__(
        self, device: StoppableDevice, requests: LinkRequests, polling: SamplePolling, clock: ClockSource, dead_man_s: float
    ) -> None:
        self._device, self._requests, self._polling, self._clock = device, requests, polling, clock
        self._dead_man = DeadManSwitch(round(dead_man_s * 1e9))
        self._failing = False
        self._last_read_mono_ns = 0
        self.opened = threading.Event()
        """Set when the first attempt to open the link has ended."""
        self.open_error: Exception | None = None
        """Error of the first attempt to open the link."""
        self.at_rest = False
        """Whether the readings after the last stop showed rest; valid at the end of the thread."""

    def run(self) -> None:
        """Open the link, run cycles until control closes it, then stop the device."""
        try:
            self._device.open()
        except Exception as error:
            # An exception of the driver during opening is raised by `DeviceLink.open`.
            self.open_error = error
            self.opened.set()
            return
        self._device.called_mono_ns = self._clock.mono_ns()
        self.opened.set()
        while not self._requests.closing:
            self._guarded(self._cycle)
            linked = self._device.connection.driver is not None
            self._requests.sleep(self._polling.next_mono_ns if linked else None, linked and not self._device.pursued)
        self._guarded(self._shut_down)

    def _guarded(self, call: Callable[[], None]) -> None:
        """Call a function and, after an exception, stop the device and continue: only this thread can stop the device."""
        try:
            call()
            self._failing = False
        except Exception as error:
            self._device.stop_pending = True
            repeated, self._failing = self._failing, True
            reason = f"its link thread failed: {error!r}"
            with contextlib.suppress(Exception):
                event = DeviceFault(self._clock.now_ns(), self._device.kind, reason, code=FaultCode.INTERNAL_ERROR)
                None if repeated else self._device.emit(event)
            pause(MAX_SLEEP_S)

    def _cycle(self) -> None:
        device, connection = self._device, self._device.connection
        now = device.called_mono_ns = self._clock.mono_ns()
        self._check_dead_man(now)
        if self._requests.take_stop():
            device.stop_pending = True
        if connection.driver is None:
            self._reopen(now)
        if device.stop_pending:
            device.stop()
        elif device.pursued:
            device.pursue()
        elif connection.driver is not None:
            self._execute_next()
        if connection.driver is not None and not self._requests.stop_waits:
            self._polling.poll_if_due()
        self._polling.check_age()

    def _check_dead_man(self, now_mono_ns: int) -> None:
        """Stop the device and discard its orders when control becomes silent."""
        silent_ns, before = self._requests.silent_ns(now_mono_ns), self._dead_man
        self._dead_man = before.checked(silent_ns)
        if self._dead_man.control_silent and not before.control_silent:
            self._requests.discard_orders()
            self._device.stop()
            reason = f"control sent no signal for {silent_ns / 1e9:.1f} s"
            self._device.emit(DeviceStopped(self._clock.now_ns(), self._device.kind, reason, code=FaultCode.CONTROL_LOST))

    def _reopen(self, now_mono_ns: int) -> None:
        """Open the link again; a pending stop is written before anything is read from the device."""
        if self._device.stop_pending:
            self._device.stop()
        if self._device.connection.open_due(now_mono_ns):
            self._device.attempt("opening the link again", self._device.open)

    def _execute_next(self) -> None:
        """Send the oldest order to the device, unless control is silent."""
        order, device, port = self._requests.take_order(), self._device, self._device.connection.port
        if order is None or port is None:
            return
        if self._dead_man.control_silent:
            reason = "a command came while control sent no keep-alive signals"
            device.emit(DeviceFault(self._clock.now_ns(), device.kind, reason, code=FaultCode.CONTROL_LOST))
            return
        self._polling.order_begins()
        device.called_mono_ns = self._clock.mono_ns()
        try:
            port.obey(order)
        except Exception as error:
            device.stop_pending = True
            device.emit(DeviceFault(self._clock.now_ns(), device.kind, str(error), code=FaultCode.ORDER_REFUSED))
            return
        device.emit(CommandAcknowledged(self._clock.now_ns(), device.kind))

    def _shut_down(self) -> None:
        """Stop the device and close the link; repeat stops, and reopen the link, until the device is at rest or the time is over."""
        device = self._device
        device.stop_pending = True
        began_mono_ns = self._last_read_mono_ns = self._clock.mono_ns()
        while not device.at_rest:
            self._close_cycle()
            now = self._clock.mono_ns()
            if now - began_mono_ns > _CLOSE_PURSUIT_S * 1e9 or now - self._last_read_mono_ns > _CLOSE_SILENCE_S * 1e9:
                break
            pause(_CLOSE_POLL_S)
        self.at_rest = device.at_rest
        device.connection.close()

    def _close_cycle(self) -> None:
        """Run one cycle of closing: open the link, stop the device, read and evaluate a sample."""
        device, connection = self._device, self._device.connection
        if connection.driver is None and connection.open_due(self._clock.mono_ns()):
            device.attempt("opening the link to stop", device.open)
        if device.stop_pending:
            device.stop()
        port = connection.port
        if port is not None and device.pursued and device.attempt("reading", lambda: self._read_pursuit(port)):
            device.pursue()

    def _read_pursuit(self, port: Port) -> None:
        if self._device.pursued:
            self._device.observe(port.read())
            self._last_read_mono_ns = self._clock.mono_ns()
