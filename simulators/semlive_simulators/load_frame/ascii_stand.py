"""A test stand with commands of single letters on a serial line, after the public manuals of Mark-10 ESM301 and ESM303.

``u`` up, ``d`` down, ``s`` stop, ``n`` travel and force, ``x`` travel, ``p`` status, ``a`` speed, ``eXXXX.X`` set speed in
mm/min, ``gXXX.XX`` and ``hXXX.XX`` set the lower and upper travel limit in mm (with a minus sign if negative), ``v`` and ``w`` read
them (upper, lower), ``l`` limit mode, ``m`` manual mode, ``z`` set travel to zero. Motions and settings have no reply; other letters are
ignored.

The status is that of the manuals: U, D or S, then L or M, then UL or DL at a limit. The manuals do not state the layout of a reading:
here it is travel, then force, each with its unit on a separate line. The stand has displacement control only.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from semlive_simulators.specimen.machine import LoadTrain

BAUD = 115_200
_COMMANDS = re.compile(rb"e(?P<speed>\d{4}\.\d)|g(?P<lower>-?\d{3}\.\d\d)|h(?P<upper>-?\d{3}\.\d\d)|(?P<letter>[a-z])")
_MIN_SPEED_MM_MIN, _MAX_SPEED_MM_MIN = 0.5, 1100.0


@dataclass(slots=True)
class _Settings:
    speed_mm_min: float = 10.0
    lower_mm: float = -5.0
    upper_mm: float = 20.0
    limit_mode: bool = False
    zero_mm: float = 0.0


class AsciiTestStand:
    """Executes commands on the machine of the bench, and answers them."""

    def __init__(self, machine: LoadTrain, now_ns: Callable[[], int]) -> None:
        self._machine = machine
        self._now_ns = now_ns
        self._settings = _Settings()

    def answer(self, burst: bytes) -> bytes:
        """The replies to all commands in a burst of bytes."""
        return b"".join(self._obey(command) for command in _COMMANDS.finditer(burst))

    def watch_limits(self) -> None:
        """Stop at a travel limit; to be called often, because the stand checks its limits continuously."""
        if self._settings.limit_mode and self._at_limit():
            direction = self._machine.jogging_mm_s
            if (direction > 0 and self._at_limit() == "UL") or (direction < 0 and self._at_limit() == "DL"):
                self._machine.stop_load()

    def _obey(self, command: re.Match[bytes]) -> bytes:
        settings, kind = self._settings, command.lastgroup
        if kind == "speed":
            settings.speed_mm_min = min(max(float(command["speed"]), _MIN_SPEED_MM_MIN), _MAX_SPEED_MM_MIN)
        elif kind == "lower":
            settings.lower_mm = float(command["lower"])
        elif kind == "upper":
            settings.upper_mm = float(command["upper"])
        else:
            return self._letter(command["letter"].decode())
        return b""

    def _letter(self, letter: str) -> bytes:
        self._machine.advance_to(self._now_ns())
        settings = self._settings
        if letter in "ud":
            self._drive(1 if letter == "u" else -1)
        elif letter == "s":
            self._machine.stop_load()
        elif letter in "lm":
            settings.limit_mode = letter == "l"
        elif letter == "z":
            settings.zero_mm = self._extension_mm()
        else:
            return self._answer_to(letter).encode()
        return b""

    def _answer_to(self, letter: str) -> str:
        settings = self._settings
        if letter == "n":
            return f"{self._travel_mm():.3f} mm\r\n{self._machine.read(self._now_ns()).force_n:.2f} N\r\n"
        if letter == "x":
            return f"{self._travel_mm():.3f} mm\r\n"
        if letter == "p":
            return f"{self._status()}\r\n"
        answers = {"a": f"{settings.speed_mm_min:.1f} mm/min", "v": f"{settings.upper_mm:.2f} mm", "w": f"{settings.lower_mm:.2f} mm"}
        return f"{answers[letter]}\r\n" if letter in answers else ""

    def _drive(self, direction: int) -> None:
        if self._machine.locked or (self._settings.limit_mode and self._at_limit() == {1: "UL", -1: "DL"}[direction]):
            return
        self._machine.jog(direction * self._settings.speed_mm_min / 60.0)

    def _extension_mm(self) -> float:
        return self._machine.read(self._now_ns()).extension_mm

    def _travel_mm(self) -> float:
        return self._extension_mm() - self._settings.zero_mm

    def _at_limit(self) -> str:
        travel_mm = self._travel_mm()
        return "UL" if travel_mm >= self._settings.upper_mm else "DL" if travel_mm <= self._settings.lower_mm else ""

    def _status(self) -> str:
        speed = self._machine.jogging_mm_s
        motion = "U" if speed > 0 else "D" if speed < 0 else "S"
        return " ".join([motion, "L" if self._settings.limit_mode else "M", self._at_limit()]).strip()
