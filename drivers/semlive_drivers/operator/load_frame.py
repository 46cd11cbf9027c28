"""A load frame that the operator moves with the program of its maker; a file or the operator gives the load."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from semlive.data.checks import Finding
from semlive.data.loading import MotionState
from semlive.ports import ClockSource, ResponseType
from semlive_drivers.composite_load_frame import CompositeLoadFrame, FrameSettings, compose
from semlive_drivers.device_part import Part, PartCommand, PartReading, Stops
from semlive_drivers.load_file.check import check_load_file
from semlive_drivers.load_file.part import CsvLoadFile, CsvSettings
from semlive_drivers.modbus import load_frame as modbus
from semlive_drivers.operator.console import TERMINAL, Console
from semlive_drivers.operator.rehearsal import RehearsedLoadFrame
from semlive_drivers.settings import checked

_CHANGE_WITHIN_S = 0.5
"""Time within which the load of a stopped load frame does not change by more than `arrived_n`."""
_STOP_REPEAT_S = 0.5
"""Shortest time between two displays of the request to stop, while the load changes."""


class OperatorFrameSettings(BaseModel):
    """Settings of a load frame that the operator moves."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    load_file: CsvSettings | None = None
    """The file that the program of the maker writes; without it the operator enters the load."""
    program: str = "the load frame's program"
    """Name of that program in requests to the operator."""
    arrived_n: float = Field(default=5.0, gt=0)
    """Distance from the target load at which the motion ends; with a file, no confirmation is required."""
    rehearsal: dict[str, Any] | None = None
    """Settings of the `modbus` driver for a simulated load frame that obeys the answers, as in `semlive demo --operator`."""


class OperatorOrders:
    """Orders to the operator, as `semlive_drivers.device_part.OrderBook`: every finite load is possible."""

    can = frozenset({PartCommand.RAMP, PartCommand.STOP})

    def order_problem(self, order: PartCommand, values: Mapping[str, float]) -> str | None:
        """Why a load cannot be requested, or None."""
        del order
        return None if all(abs(value) < float("inf") for value in values.values()) else "a load that is no number cannot be requested"

    def step_of(self, value: str) -> float:
        """0: the operator takes no jogs."""
        del value
        return 0.0


class OperatorCrosshead:
    """The DevicePart over a person: a ramp is shown as a request, and ends when the operator confirms it.

    Args:
        settings: validated settings.
        console: terminal for the requests.
        has_file: whether a file gives the load; otherwise the operator enters it.
    """

    simulated = False
    manual = True
    has_watchdog = True  # without a further request the operator moves nothing
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
        self.book, self.stops = OperatorOrders(), Stops(self._request_stop)

    def read(self) -> PartReading:
        """The target, the load that the operator entered, and the motion state."""
        with self._lock:
            ignores_stop = self._stop_requested and self._load_changes()
            motion = MotionState.MOVING if self._moving or ignores_stop else MotionState.STOPPED
            return PartReading(None if self._has_file else self._entered_n, None, motion, self._target_n)

    def identify(self) -> PartReading:
        """As `read`."""
        return self.read()

    def arrived(self) -> None:
        """End the motion: the load in the file has reached the target."""
        with self._lock:
            was_moving, self._moving = self._moving, False
        if was_moving:
            self._console.withdraw(self._receive_answer)
            self._console.show(f"the load is {self._target_n:g} N; hold it there")

    def note_load(self, force_n: float) -> None:
        """Store the load in the file, N: a load that changes after a request to stop is a motion."""
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
        """Target load of the open request, N; None without one."""
        with self._lock:
            return self._target_n if self._moving else None

    def command(self, order: PartCommand, values: Mapping[str, float]) -> None:
        """Show the request for a load, or to stop."""
        if order is PartCommand.STOP:
            with self._lock:
                was_moving, self._moving = self._moving or self._load_changes(), False
                self._stop_requested = self._stop_requested or was_moving
                now_s = time.monotonic()
                shows = was_moving and now_s >= self._shown_mono_s + _STOP_REPEAT_S
                self._shown_mono_s = now_s if shows else self._shown_mono_s
            self._console.withdraw(self._receive_answer)
            if shows:
                self._console.show(f"STOP the motion in {self._settings.program} and hold")
            return
        with self._lock:
            self._target_n, self._moving, self._stop_requested = values["force_n"], True, False
            self._shown_mono_s = -math.inf
        answer = "press enter when it is there" if self._has_file else "type the load in N and press enter when it is there"
        rate = f"at {values['rate_n_s']:g} N/s, then hold"
        response = ResponseType.CONFIRMATION if self._has_file else ResponseType.LOAD_N
        request = f"in {self._settings.program}, bring the load to {values['force_n']:g} N {rate}; {answer}"
        self._console.ask(request, self._receive_answer, response)

    def order_changed(self) -> str | None:
        """None: there are no registers."""
        return None

    def resolution(self) -> tuple[float, float]:
        """0: the operator may enter any number."""
        return 0.0, 0.0

    def blind_stop(self) -> None:
        """Show the request to stop."""
        self.command(PartCommand.STOP, {})

    def close(self) -> None:
        """Withdraw an open request."""
        self._console.withdraw(self._receive_answer)

    def _request_stop(self) -> bool:
        self.command(PartCommand.STOP, {})
        return True

    def _receive_answer(self, line: str) -> bool:
        """Evaluate a typed line; True if it ends the motion."""
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
    """A growing file whose load ends the motion of the operator's part at the target."""

    def __init__(self, load_file: CsvLoadFile, drive: OperatorCrosshead, arrived_n: float) -> None:
        self._load_file, self._drive, self._arrived_n = load_file, drive, arrived_n
        self.where, self.capabilities = load_file.where, load_file.capabilities
        self.simulated, self.has_watchdog = load_file.simulated, load_file.has_watchdog

    def read(self) -> PartReading:
        """The values in the newest complete line; raises as `CsvLoadFile.read`."""
        reading, target_n = self._load_file.read(), self._drive.target_n
        if reading.force_n is not None:
            self._drive.note_load(reading.force_n)
        if target_n is not None and reading.force_n is not None and abs(reading.force_n - target_n) <= self._arrived_n:
            self._drive.arrived()
        return reading

    def identify(self) -> PartReading:
        """As `read`."""
        return self.read()

    def command(self, order: PartCommand, values: Mapping[str, float]) -> None:
        """Refuse an order; raises as `CsvLoadFile.command`."""
        self._load_file.command(order, values)

    def blind_stop(self) -> None:
        """Do nothing: nothing moves."""

    def close(self) -> None:
        """Do nothing: nothing is open."""


def open_load_frame(
    settings: Mapping[str, object], clock: ClockSource, *, console: Console = TERMINAL
) -> CompositeLoadFrame | RehearsedLoadFrame:
    """A load frame that the operator moves on requests at the terminal.

    Raises:
        BadConfig: for settings that are not valid.
        LinkRefused: if the file does not exist.
        LinkError: if the file contains no reading.
    """
    frame_keys, operator_keys = FrameSettings.split(settings)
    frame_settings = checked(FrameSettings, frame_keys, "operator load frame")
    config = checked(OperatorFrameSettings, operator_keys, "operator load frame")
    drive = OperatorCrosshead(config, console, config.load_file is not None)
    parts: list[Part] = [drive]
    if config.load_file is not None:
        parts.insert(0, MonitoredLoadFile(CsvLoadFile(config.load_file, clock), drive, config.arrived_n))
    hand = compose(parts, frame_settings, clock)
    return hand if config.rehearsal is None else RehearsedLoadFrame(hand, modbus.open_load_frame(config.rehearsal, clock))


def check_files(settings: Mapping[str, object], clock: ClockSource) -> list[Finding]:
    """Read the newest line of the load file, if there is one, as a run would.

    Raises:
        BadConfig: for settings that are not valid.
    """
    config = checked(OperatorFrameSettings, FrameSettings.split(settings)[1], "operator load frame")
    return [] if config.load_file is None else [check_load_file("load_file", config.load_file, clock)]
