"""A load frame that a hand moves, by the closed software of its maker: semlive asks, and reads the load where it can."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict, Field

from semlive.data.loading import MotionState
from semlive.data.operator_prompts import ResponseType
from semlive.errors import SemliveError
from semlive.ports import ClockSource
from semlive_drivers.composite_load_frame import CompositeLoadFrame, FrameSettings
from semlive_drivers.csv_load_file import CsvLoadFile, CsvSettings
from semlive_drivers.device_part import Part, PartCommand, PartReading, Stops
from semlive_drivers.modbus.settings import checked
from semlive_drivers.operator.console import TERMINAL, Console

_CHANGE_WITHIN_S = 0.5
"""Time within which a load that a person holds does not change by more than `arrived_n`."""
_STOP_AGAIN_S = 0.5
"""Least time from one display of the request to stop to the next, while the load changes."""


class OperatorFrameSettings(BaseModel):
    """Settings of a load frame that a hand moves."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    load_file: CsvSettings | None = None
    """The file that the maker's program records into; without it the operator enters the load."""
    program: str = "the load frame's program"
    """What the operator calls it."""
    arrived_n: float = Field(default=5.0, gt=0)
    """This close to the target the motion is over; with a file without a word."""


class SpokenOrders:
    """What a person can be asked for, as `semlive_drivers.device_part.OrderBook`: any load that is a number."""

    can = frozenset({PartCommand.RAMP, PartCommand.STOP})

    def order_problem(self, what: PartCommand, values: Mapping[str, float]) -> str | None:
        """Why a load cannot be asked for, or None."""
        del what
        return None if all(abs(value) < float("inf") for value in values.values()) else "a load that is no number cannot be asked for"

    def step_of(self, value: str) -> float:
        """0: a person is not asked to travel."""
        del value
        return 0.0


class OperatorCrosshead:
    """The Part over a person: told a load, it asks for it; the motion is over when the operator says so.

    Args:
        settings: checked settings.
        console: where it is asked.
        has_file: a file tells the load; otherwise what is typed does.
    """

    simulated = False
    manual = True
    has_watchdog = True  # a hand stops when it is not asked on
    capabilities = frozenset({PartCommand.RAMP, PartCommand.STOP})

    def __init__(self, settings: OperatorFrameSettings, console: Console, has_file: bool) -> None:
        self._settings, self._console, self._has_file = settings, console, has_file
        self._lock = threading.Lock()
        self._target_n = 0.0
        self._entered_n = 0.0
        self._moving = self._stop_requested = False
        self._loads_n: deque[tuple[float, float]] = deque()
        self._shown_mono_s = -math.inf
        self.where = "a hand"
        self.book, self.stops = SpokenOrders(), Stops(self._ask_to_stop)

    def read(self) -> PartReading:
        """The target, the load that was entered, and whether the operator is still at it."""
        with self._lock:
            unheeded = self._stop_requested and self._load_changes()
            motion = MotionState.MOVING if self._moving or unheeded else MotionState.STOPPED
            return PartReading(None if self._has_file else self._entered_n, None, motion, self._target_n)

    def identify(self) -> PartReading:
        """The same."""
        return self.read()

    def arrived(self) -> None:
        """The load is there, as the file says."""
        with self._lock:
            over, self._moving = self._moving, False
        if over:
            self._console.withdraw(self._heard)
            self._console.show(f"the load is {self._target_n:g} N; hold it there")

    def note_load(self, force_n: float) -> None:
        """Take the load that the file shows, N: a load that changes after a request to stop is a motion."""
        now_s = time.monotonic()
        with self._lock:
            self._loads_n.append((now_s, force_n))
            while self._loads_n[0][0] < now_s - _CHANGE_WITHIN_S:
                self._loads_n.popleft()

    def _load_changes(self) -> bool:
        """Whether the load of the file changed by more than `arrived_n` within `_CHANGE_WITHIN_S`."""
        loads_n = [force_n for _, force_n in self._loads_n]
        return bool(loads_n) and max(loads_n) - min(loads_n) > self._settings.arrived_n

    @property
    def target_n(self) -> float | None:
        """Where the load is brought to, or None while nothing is asked."""
        with self._lock:
            return self._target_n if self._moving else None

    def command(self, what: PartCommand, values: Mapping[str, float]) -> None:
        """Ask for a load, or to stop."""
        if what is PartCommand.STOP:
            with self._lock:
                moves, self._moving = self._moving or self._load_changes(), False
                self._stop_requested = self._stop_requested or moves
                now_s = time.monotonic()
                shows = moves and now_s >= self._shown_mono_s + _STOP_AGAIN_S
                self._shown_mono_s = now_s if shows else self._shown_mono_s
            self._console.withdraw(self._heard)
            if shows:
                self._console.show(f"STOP the motion in {self._settings.program} and hold")
            return
        with self._lock:
            self._target_n, self._moving, self._stop_requested = values["force_n"], True, False
            self._shown_mono_s = -math.inf
        answer = "press enter when it is there" if self._has_file else "type the load in N and press enter when it is there"
        rate = f"at {values['rate_n_s']:g} N/s, then hold"
        wanted = ResponseType.CONFIRMATION if self._has_file else ResponseType.LOAD_N
        self._console.ask(f"in {self._settings.program}, bring the load to {values['force_n']:g} N {rate}; {answer}", self._heard, wanted)

    def order_changed(self) -> str | None:
        """None: a person has no registers."""
        return None

    def resolution(self) -> tuple[float, float]:
        """0: a person may type any number."""
        return 0.0, 0.0

    def blind_stop(self) -> None:
        """Ask to stop."""
        self.command(PartCommand.STOP, {})

    def close(self) -> None:
        """Take a question back."""
        self._console.withdraw(self._heard)

    def _ask_to_stop(self) -> bool:
        self.command(PartCommand.STOP, {})
        return True

    def _heard(self, line: str) -> bool:
        """What the operator typed; True when the motion is over."""
        if not self._has_file:
            try:
                entered_n = float(line.replace(",", "."))
            except ValueError:
                entered_n = float("nan")
            if not abs(entered_n) < float("inf"):
                self._console.show(f"{line or 'nothing'} is no load; type the load in N as {self._settings.program} shows it")
                return False
            with self._lock:
                self._entered_n = entered_n
            if abs(entered_n - self._target_n) > self._settings.arrived_n:
                self._console.show(
                    f"that is {entered_n - self._target_n:+g} N from {self._target_n:g} N; bring it nearer and type it again"
                )
                return False
        with self._lock:
            self._moving = False
        return True


class MonitoredLoadFile:
    """A growing file that also tells the operator's part when the load is there."""

    def __init__(self, tail: CsvLoadFile, drive: OperatorCrosshead, arrived_n: float) -> None:
        self._tail, self._drive, self._arrived_n = tail, drive, arrived_n
        self.where, self.simulated, self.has_watchdog, self.capabilities = tail.where, tail.simulated, tail.has_watchdog, tail.capabilities

    def read(self) -> PartReading:
        """The newest whole line; raises as `CsvLoadFile.read`."""
        said, target_n = self._tail.read(), self._drive.target_n
        if said.force_n is not None:
            self._drive.note_load(said.force_n)
        if target_n is not None and said.force_n is not None and abs(said.force_n - target_n) <= self._arrived_n:
            self._drive.arrived()
        return said

    def identify(self) -> PartReading:
        """The same."""
        return self.read()

    def command(self, what: PartCommand, values: Mapping[str, float]) -> None:
        """Nothing can be told to a file; raises as `CsvLoadFile.command`."""
        self._tail.command(what, values)

    def blind_stop(self) -> None:
        """Nothing moves."""

    def close(self) -> None:
        """Nothing stays open."""


def open_load_frame(settings: Mapping[str, object], clock: ClockSource, *, console: Console = TERMINAL) -> CompositeLoadFrame:
    """A load frame that a hand moves, asked on the terminal.

    Raises:
        BadConfig: for settings that are not understood.
        LinkRefused: if the file is not there.
        LinkError: if it holds no reading.
    """
    own, rest = FrameSettings.split(settings)
    known = checked(FrameSettings, own, "operator load frame")
    given = checked(OperatorFrameSettings, rest, "operator load frame")
    drive = OperatorCrosshead(given, console, given.load_file is not None)
    parts: list[Part] = [drive]
    if given.load_file is not None:
        parts.insert(0, MonitoredLoadFile(CsvLoadFile(given.load_file, clock), drive, given.arrived_n))
    try:
        return CompositeLoadFrame(parts, known, clock)
    except SemliveError:
        for part in parts:
            part.close()
        raise
