"""Experiment time for the shell: this computer's clock, or the line that a simulator publishes."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from semlive.data.clock import Clock
from semlive.errors import BadConfig, BadInput
from semlive.formats.tables.clock_file import decode_clock


class SystemClock:
    """Experiment time at an instrument: UTC read once, then carried by the monotonic clock.

    Args:
        line: the line that the run began with, if this computer has not been started anew since.
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

    A stretch sets the line back; `now_ns` then stands still until the line has caught up, so it never goes back.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._seen: tuple[int, int] = (0, 0)
        self._latest_ns = 0
        self._clock = self._read()

    def _read(self) -> Clock:
        try:
            state = self._path.stat()
            seen = (state.st_mtime_ns, state.st_ino)
            if seen != self._seen:
                self._clock = decode_clock(self._path.read_bytes())
                self._seen = seen
        except BadInput as error:
            # Whoever asks for the time in the middle of a run may be the thread that has to stop the machine.
            if self._seen == (0, 0):
                raise BadConfig(f"{self._path}: {error}") from error
        except OSError as error:
            if self._seen == (0, 0):
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
            self._latest_ns = max(self._latest_ns, self._read().time_ns(time.monotonic_ns()))
            return self._latest_ns


def open_clock(clock_file: Path | None, line: Clock | None = None) -> SystemClock | SimulatedClock:
    """The clock of this run.

    Args:
        clock_file: published by a simulator, or None at an instrument.
        line: the line of the same run before it was interrupted, where this computer's monotonic clock still is the one that it stands on.

    Raises:
        BadConfig: the clock file does not exist or is not one.
    """
    return SystemClock(line) if clock_file is None else SimulatedClock(clock_file)
