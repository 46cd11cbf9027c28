"""Experiment time of a run: the clock of this computer, or the clock that a simulator publishes; and the boot of its monotonic clock."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

from semlive.data.clock import Clock
from semlive.errors import BadConfig, BadInput
from semlive.formats.tables.clock_file import decode_clock


class SystemClock:
    """Experiment time at an instrument: UTC is read once and continued by the monotonic clock.

    Args:
        line: clock relation of the run before it was interrupted, if the computer was not restarted since; None for a new run.
    """

    def __init__(self, line: Clock | None = None) -> None:
        self._clock = line or Clock(time.time_ns(), time.monotonic_ns())

    def current(self) -> Clock:
        """Return the present clock relation."""
        return self._clock

    def mono_ns(self) -> int:
        """Monotonic wall clock, ns."""
        return time.monotonic_ns()

    def now_ns(self) -> int:
        """Experiment time, UTC ns; a step of the computer's UTC does not move it."""
        return self._clock.time_ns(time.monotonic_ns())


class SimulatedClock:
    """Experiment time from a clock file that is replaced when the simulation stretches its clock.

    After a stretch `now_ns` is constant, as for the simulated devices, until the clock has caught up.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._file_version: tuple[int, int] = (0, 0)
        self._latest_ns = 0
        self._clock = self._read()

    def _read(self) -> Clock:
        try:
            state = self._path.stat()
            version = (state.st_mtime_ns, state.st_ino)
            if version != self._file_version:
                self._clock = decode_clock(self._path.read_bytes())
                self._file_version = version
        except BadInput as error:
            # In the middle of a run the caller may be the thread that has to stop the machine, so the last valid clock is used.
            if self._file_version == (0, 0):
                raise BadConfig(f"{self._path}: {error}") from error
        except OSError as error:
            if self._file_version == (0, 0):
                raise BadConfig(
                    f"{self._path}: cannot be read ({error.strerror}); start the simulator that publishes this clock"
                ) from error
        return self._clock

    def current(self) -> Clock:
        """Return the present clock relation."""
        with self._lock:
            return self._read()

    def mono_ns(self) -> int:
        """Monotonic wall clock, ns."""
        return time.monotonic_ns()

    def now_ns(self) -> int:
        """Experiment time, UTC ns; never goes back."""
        with self._lock:
            self._latest_ns = max(self._latest_ns, self._read().now_ns(time.monotonic_ns()))
            return self._latest_ns


def open_clock(clock_file: Path | None, line: Clock | None = None) -> SystemClock | SimulatedClock:
    """Open the clock of a run.

    Args:
        clock_file: file that a simulator publishes; None at an instrument.
        line: clock relation of the run before it was interrupted, if it refers to the present boot of this computer; else None.

    Raises:
        BadConfig: the clock file does not exist or cannot be read.
    """
    return SystemClock(line) if clock_file is None else SimulatedClock(clock_file)


def boot_id() -> str:
    """Return the identity of the boot that the monotonic clock belongs to; empty if the system does not provide one."""
    path = Path("/proc/sys/kernel/random/boot_id")
    return path.read_text(encoding="ascii").strip() if os.name == "posix" and path.exists() else ""
