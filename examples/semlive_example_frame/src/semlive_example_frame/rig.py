"""The driver with its machine behind it, for semlive's contract checks."""

from __future__ import annotations

import time

from semlive.ports import LoadFrame
from semlive_example_frame.driver import open_load_frame
from semlive_example_frame.machine import Machine


class _WallClock:
    def now_ns(self) -> int:
        return time.time_ns()

    def mono_ns(self) -> int:
        return time.monotonic_ns()


class ExampleRig:
    """See `semlive_drivers.conformance.DriverFixture`."""

    reachable_n = 50.0
    tolerance_n = 0.1
    can_disconnect = True

    def __init__(self) -> None:
        self._machine = Machine()

    def open(self) -> LoadFrame:
        """Open the driver."""
        return open_load_frame({"port": self._machine.port}, _WallClock())

    def moves(self) -> bool:
        """Whether the load is on its way."""
        return self._machine.moving

    def disconnect(self) -> None:
        """The machine hears nothing any more."""
        self._machine.deaf = True

    def reconnect(self) -> None:
        """It hears again."""
        self._machine.deaf = False

    def end(self) -> None:
        """End the machine."""
        self._machine.end()
