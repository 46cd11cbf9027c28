"""Calls of a driver whose failure stops the device, and repetition of the stop until the readings show rest.

Theory of operation
-------------------
All methods are called by the link thread and block for at most one call of the driver. `attempt` wraps each call: an error closes the
connection, and if the device may move, a stop is first written without waiting for an answer. A stop that could not be sent stays pending;
without a connection it is written blind, on the schedule of the pursuit (`stop_pursuit`), until a driver is open again.

`emit` passes events to control. If control no longer accepts events, a stop becomes pending, because then nothing may move.
"""

from __future__ import annotations

from collections.abc import Callable

from semlive.data.faults import FaultCode
from semlive.data.loading import LoadSample, StageSample
from semlive.engine.events import Device, DeviceFault, DeviceStopped, Event
from semlive.errors import LinkError
from semlive.ports import ClockSource, LoadFrame, Stage
from semlive.service.device_link.connection import Connection, write_stop
from semlive.service.device_link.stop_pursuit import StopPursuit, begin_pursuit


class StoppableDevice:
    """A device, whether it may move, and the stop that is pending or pursued.

    Args:
        kind: kind of the device, for events.
        connection: connection to its driver.
        on_event: callback for engine events; must not block.
        clock: experiment time and the monotonic clock.
    """

    def __init__(self, kind: Device, connection: Connection, on_event: Callable[[Event], None], clock: ClockSource) -> None:
        self.kind, self.connection = kind, connection
        self._on_event, self._clock = on_event, clock
        self._pursuit: StopPursuit | None = None
        self.stop_pending = False
        self.may_move = False
        self.called_mono_ns = clock.mono_ns()
        """Time of the last call of the driver or begin of a cycle; read by control."""
        self.failure = ""
        """Reason of the last failure of the connection."""

    @property
    def pursued(self) -> bool:
        """Whether a stop was sent whose effect the readings have not confirmed."""
        return self._pursuit is not None

    @property
    def at_rest(self) -> bool:
        """Whether no stop is pending and the effect of the last one is confirmed."""
        return not self.stop_pending and self._pursuit is None

    def emit(self, event: Event) -> None:
        """Pass an event to control."""
        try:
            self._on_event(event)
        except Exception:
            # Control no longer receives events (a closed event loop raises RuntimeError): then nothing may move.
            self.stop_pending = True

    def open(self) -> None:
        """Open the connection; raises what the driver raises."""
        self.connection.open()
        if self.may_move:
            self.stop_pending = True

    def attempt(self, action: str, call: Callable[[], None]) -> bool:
        """Call the driver; an error closes the connection, and the next cycle opens a new one.

        Args:
            action: what the call does, for the fault message.
            call: the call.

        Returns:
            Whether the call succeeded.
        """
        self.called_mono_ns = self._clock.mono_ns()
        try:
            call()
        except Exception as error:
            # An error in a driver must not end the thread, because only it can stop the device.
            self._fail(str(error) if isinstance(error, LinkError) else f"{action} failed in the driver: {error!r}")
            return False
        return True

    def stop(self) -> None:
        """Stop the device and begin the pursuit; a failed stop remains pending and is sent first when the link is open again."""
        self.stop_pending = True
        now = self._clock.mono_ns()
        pursuit = self._pursuit or begin_pursuit(now)
        port = self.connection.port
        if port is None:
            self._stop_blind(pursuit)
            return
        self._pursuit = pursuit.sent_again(now)
        if self.attempt("stopping", port.stop):
            self.stop_pending = False

    def observe(self, sample: LoadSample | StageSample) -> None:
        """Add a sample to the pursuit of a stop, if there is one."""
        if self._pursuit is not None:
            self._pursuit = self._pursuit.with_sample(sample)

    def pursue(self) -> None:
        """Repeat the stop while the device moves; the pursuit ends when the device is at rest."""
        pursuit, port = self._pursuit, self.connection.port
        if pursuit is None:
            return
        now, motionless = self._clock.mono_ns(), None if port is None else port.still()
        if pursuit.rests(motionless):
            self._pursuit = None
            return
        if pursuit.moves(motionless):
            self._alarm(pursuit, moves=True)
        if pursuit.due(now, motionless):
            self.stop()

    def _stop_blind(self, pursuit: StopPursuit) -> None:
        """Without a connection: write the stop to the address of the failed driver, if it is due."""
        now = self._clock.mono_ns()
        if now < pursuit.next_mono_ns:
            self._pursuit = pursuit
            return
        self._pursuit = pursuit.sent_again(now)
        self._alarm(pursuit, moves=False)
        self.called_mono_ns = now
        self.connection.stop_failed_driver()

    def _alarm(self, pursuit: StopPursuit, *, moves: bool) -> None:
        """Emit STOP_NOT_OBEYED if it is due: the machine still moves or cannot be reached, so a person must stop it."""
        now = self._clock.mono_ns()
        if not pursuit.alarm_due(now, moves):
            return
        self._pursuit = (self._pursuit or pursuit).with_alarm(moves)
        since_s = (now - pursuit.began_mono_ns) / 1e9
        if moves:
            what = f"it still moves {since_s:.1f} s after the first of {pursuit.sent} stop orders"
        else:
            what = f"no stop order was confirmed for {since_s:.1f} s, and it may move"
        reason = f"{what}: press the emergency stop of the machine"
        self.emit(DeviceFault(self._clock.now_ns(), self.kind, reason, code=FaultCode.STOP_NOT_OBEYED))

    def _fail(self, reason: str) -> None:
        """Close a failed connection; stop the device first if it may move."""
        self.failure = reason
        driver = self.connection.driver
        if driver is not None:
            self._stop_before_closing(driver, reason)
        self.connection.drop()

    def _stop_before_closing(self, driver: LoadFrame | Stage, reason: str) -> None:
        if self.may_move or self.stop_pending:
            # The device may still execute orders although its answers are invalid; on a broken link this fails at once.
            write_stop(driver)
            now = self._clock.mono_ns()
            self._pursuit = (self._pursuit or begin_pursuit(now)).sent_again(now)
        if self.may_move and not self.stop_pending:
            self.stop_pending = True
            what = f"the link failed while it may have moved: {reason}; if it moves on, press its emergency stop"
            self.emit(DeviceStopped(self._clock.now_ns(), self.kind, what, code=FaultCode.LINK_LOST))
