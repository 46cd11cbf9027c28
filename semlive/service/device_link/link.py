"""Link to one device, as control uses it: open, send orders, stop, close, and the state of the link.

Theory of operation
-------------------
`DeviceLink` belongs to control and owns one thread (`LinkThread`), which alone calls the driver. `send`, `stop` and `keep_alive` write
to `LinkRequests` and return at once. `open` and `close` block: `open` until the device has answered, `close` until the device is at rest
or the time is over. Events reach control by the callback `on_event`, which the link thread calls.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable

from semlive.data.experiment import Limits
from semlive.data.loading import DeviceIdentity, StageKind
from semlive.engine.events import Device, Event
from semlive.engine.resume import RampOrder
from semlive.errors import LinkRefused
from semlive.ports import ClockSource, LoadFrame, OrderCheck, Stage
from semlive.service.device_link.connection import Connection
from semlive.service.device_link.polling import SamplePolling
from semlive.service.device_link.ports import Order
from semlive.service.device_link.requests import LinkRequests
from semlive.service.device_link.stopping import StoppableDevice
from semlive.service.device_link.thread import LinkThread


class DeviceLink:
    """Link to one device, with its thread, from opening to closing.

    Args:
        device: kind of the device, for events.
        open_device: opens a new link at each call; called in the thread only.
        on_event: callback for engine events, in the thread; must not block. If it raises, the device is stopped.
        clock: experiment time and the monotonic clock.
        limits: soft limits, checked here for every sample, as in the engine; also the ages at which a sample is stale or the link lost.
        poll_s: wall time between readings, s.
        dead_man_s: longest wall time between calls of `keep_alive`, s; beyond it the device is stopped.
        recalled: last ramp in the log of a resumed run, to be compared with the command in the device. None: a new run.
    """

    def __init__(
        self,
        device: Device,
        open_device: Callable[[], LoadFrame] | Callable[[], Stage],
        on_event: Callable[[Event], None],
        *,
        clock: ClockSource,
        limits: Limits,
        poll_s: float = 0.05,
        dead_man_s: float = 2.0,
        recalled: RampOrder | None = None,
    ) -> None:
        self._clock = clock
        self._connection = Connection(open_device, clock, limits, recalled)
        self._device = StoppableDevice(device, self._connection, on_event, clock)
        self._requests = LinkRequests(clock)
        self._polling = SamplePolling(self._device, clock, limits, poll_s)
        self._body = LinkThread(self._device, self._requests, self._polling, clock, dead_man_s)
        self._thread = threading.Thread(target=self._body.run, name=f"link to {device.words}", daemon=True)

    def open(self, timeout_s: float = 10.0) -> DeviceIdentity:
        """Start the thread and wait until the device has answered.

        Raises:
            LinkRefused: if the device does not answer in time.
            LinkError: if another device answers, or the answer is invalid.
            BadConfig: if the driver rejects its settings.
        """
        self.keep_alive()
        self._thread.start()
        if not self._body.opened.wait(timeout_s):
            self.close(0.0)
            raise LinkRefused(f"the {self._device.kind.words} did not answer within {timeout_s:g} s; check that it is on and connected")
        if self._body.open_error is not None:
            raise self._body.open_error
        self.keep_alive()
        return self.identity

    @property
    def identity(self) -> DeviceIdentity:
        """Identity of the device when the link was first opened."""
        if self._connection.identity is None:
            raise RuntimeError("the link is not open")
        return self._connection.identity

    @property
    def stage_kind(self) -> StageKind | None:
        """Whether a stage moves the specimen or the beam; None for a load frame, and before the link is opened."""
        return self._connection.stage_kind

    def order_problem(self, ramps: Iterable[tuple[float, float]]) -> str | None:
        """Return why one of the ramps (target in N, rate in N/s) cannot be ordered exactly, or None.

        Sends nothing; to be called right after opening.
        """
        driver = self._connection.driver
        if not isinstance(driver, OrderCheck):
            return None
        return next((problem for ramp in ramps if (problem := driver.order_problem(*ramp))), None)

    @property
    def sample_age_s(self) -> float:
        """Wall time since the last sample; infinite before the first."""
        return self._polling.age_s

    @property
    def blocked_s(self) -> float:
        """Wall time since the thread called its driver or began a cycle, s; it increases while a driver call does not return."""
        running = self._thread.is_alive() and self._body.opened.is_set()
        return (self._clock.mono_ns() - self._device.called_mono_ns) / 1e9 if running else 0.0

    def keep_alive(self) -> None:
        """Signal that control is alive."""
        self._requests.keep_alive()

    def send(self, command: Order) -> None:
        """Queue a motion command; returns at once. CommandAcknowledged or DeviceFault follows, unless a stop comes first."""
        self._requests.send(command)

    def stop(self, reason: str) -> None:
        """Stop motion before any other action and discard queued commands; returns at once."""
        del reason  # the caller records it
        self._requests.stop()

    def close(self, timeout_s: float = 12.0) -> bool:
        """Stop motion, close the link and end the thread; never raises, may be called repeatedly.

        Returns:
            True if the readings after the last stop show rest, or if the link was never open; False if it is
            unknown whether the device is at rest.
        """
        first = self._requests.close()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            # There is no second wait for a thread that did not end in time.
            self._thread.join(timeout_s if first else 0.0)
        return self._connection.identity is None or (self._body.at_rest and not self._thread.is_alive())
