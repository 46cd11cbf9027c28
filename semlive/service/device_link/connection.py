"""Connection to the driver of a device: opening, identity, the interval between attempts, and the blind stop of a failed connection.

Theory of operation
-------------------
The link thread alone opens, closes and calls the driver. Opening blocks for at most the timeout of the driver. After a failure the
driver is closed and stays available for blind stops until the next driver is open, because the device may still execute orders
whose answers are lost. Control reads `identity` and `stage_kind` after the link has been opened; both are set once.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from semlive.data.experiment import Limits
from semlive.data.loading import DeviceIdentity, StageKind
from semlive.engine.resume import RampOrder
from semlive.errors import LinkError
from semlive.ports import BlindStop, ClockSource, LoadFrame, OrderRecall, Stage
from semlive.service.device_link.ports import Port, port_of

_BACKOFF_S = (0.0, 0.1, 0.2, 0.5, 1.0)
"""Intervals between attempts to open the link, s; the last one is repeated."""


class Connection:
    """The open driver of a device, or the time of the next attempt to open it.

    Args:
        open_device: opens a driver at each call.
        clock: the monotonic clock.
        limits: soft limits of the run.
        recalled: last ramp in the log of a resumed run; None for a new run.
    """

    def __init__(
        self,
        open_device: Callable[[], LoadFrame] | Callable[[], Stage],
        clock: ClockSource,
        limits: Limits,
        recalled: RampOrder | None,
    ) -> None:
        self._open_device, self._clock, self._limits, self._recalled = open_device, clock, limits, recalled
        self.driver: LoadFrame | Stage | None = None
        self.port: Port | None = None
        self.identity: DeviceIdentity | None = None
        self.stage_kind: StageKind | None = None
        self._failed_driver: LoadFrame | Stage | None = None
        self._failures = 0
        self._next_open_mono_ns = 0

    def open(self) -> None:
        """Open the driver.

        Raises:
            LinkError: another device answers than before.
            Exception: any error of the driver.
        """
        driver = self._open_device()
        try:
            identity = driver.identity
            if self.identity is not None and identity.name != self.identity.name:
                raise LinkError(f"another device answers: {identity.name} instead of {self.identity.name}; check what is connected")
        except Exception:
            with contextlib.suppress(Exception):
                driver.close()
            raise
        self.port = port_of(driver, self._limits)
        if self.identity is None and self._recalled is not None and isinstance(driver, OrderRecall):
            driver.recall_order(self._recalled.force_n, self._recalled.rate_n_s)
        self.driver, self.identity, self._failed_driver = driver, identity, None
        self.stage_kind = None if isinstance(driver, LoadFrame) else driver.kind

    def open_due(self, now_mono_ns: int) -> bool:
        """Whether the next attempt to open the link is due."""
        return now_mono_ns >= self._next_open_mono_ns

    def answered(self) -> None:
        """Restart the intervals between attempts, after a reading."""
        self._failures = 0

    def drop(self) -> None:
        """Close a failed driver, keep it for blind stops, and schedule the next attempt."""
        if self.driver is not None:
            # The close of a driver must not raise, but a driver may violate that rule.
            with contextlib.suppress(Exception):
                self.driver.close()
            self._failed_driver = self.driver
        self.driver = self.port = None
        self._next_open_mono_ns = self._clock.mono_ns() + round(_BACKOFF_S[min(self._failures, len(_BACKOFF_S) - 1)] * 1e9)
        self._failures += 1

    def close(self) -> None:
        """Close the open driver, if there is one; never raises."""
        if self.driver is not None:
            with contextlib.suppress(Exception):
                self.driver.close()
            self.driver = None

    def stop_failed_driver(self) -> None:
        """Write a stop to the address of the failed driver; never raises."""
        if self._failed_driver is not None:
            write_stop(self._failed_driver)


def write_stop(driver: LoadFrame | Stage) -> None:
    """Write a stop without waiting for an answer where the driver can do so; never raises."""
    with contextlib.suppress(Exception):  # the blind stop of a port never raises, but a driver may
        if isinstance(driver, BlindStop):
            driver.stop_blind()
        else:
            driver.stop()
