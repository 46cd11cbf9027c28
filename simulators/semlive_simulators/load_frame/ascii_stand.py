"""A test stand that is spoken to in single letters over a serial line, after the public manuals of Mark-10's ESM301 and ESM303.

``u`` up, ``d`` down, ``s`` stop, ``n`` travel and force, ``x`` travel, ``p`` status, ``a`` speed, ``eXXXX.X`` set speed in
mm/min, ``gXXX.XX`` and ``hXXX.XX`` lower and upper travel limit in mm (a minus sign in front if needed), ``v`` and ``w`` ask for
them (upper, lower), ``l`` limit mode, ``m`` manual mode, ``z`` travel is zero here. Motions and settings have no reply; letters
that mean nothing are passed over.

The status is what the manuals list: U, D or S, then L or M, then UL or DL at a limit. How a reading is laid out they do not
say: here it is travel, then force, each with its unit on a line of its own. Displacement control only, as such stands are.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from semlive_simulators.specimen.machine import LoadTrain

BAUD = 115_200
_WORDS = re.compile(rb"e(?P<speed>\d{4}\.\d)|g(?P<lower>-?\d{3}\.\d\d)|h(?P<upper>-?\d{3}\.\d\d)|(?P<letter>[a-z])")
_SLOWEST_MM_MIN, _FASTEST_MM_MIN = 0.5, 1100.0


@dataclass(slots=True)
class _Settings:
    speed_mm_min: float = 10.0
    lower_mm: float = -5.0
    upper_mm: float = 20.0
    limit_mode: bool = False
    zero_mm: float = 0.0


class AsciiTestStand:
    """Answers letters by driving the bench's machine."""

    def __init__(self, machine: LoadTrain, now_ns: Callable[[], int]) -> None:
        self._machine = machine
        self._now_ns = now_ns
        self._settings = _Settings()

    def answer(self, burst: bytes) -> bytes:
        """The replies to all commands in a burst of bytes."""
        return b"".join(self._obey(word) for word in _WORDS.finditer(burst))

    def watch_limits(self) -> None:
        """Stop at a travel limit; to be called often, as the stand looks at its limits all the time."""
        if self._settings.limit_mode and self._at_limit():
            direction = self._machine.jogging_mm_s
            if (direction > 0 and self._at_limit() == "UL") or (direction < 0 and self._at_limit() == "DL"):
                self._machine.stop_load()

    def _obey(self, word: re.Match[bytes]) -> bytes:
        settings, given = self._settings, word.lastgroup
        if given == "speed":
            settings.speed_mm_min = min(max(float(word["speed"]), _SLOWEST_MM_MIN), _FASTEST_MM_MIN)
        elif given == "lower":
            settings.lower_mm = float(word["lower"])
        elif given == "upper":
            settings.upper_mm = float(word["upper"])
        else:
            return self._letter(word["letter"].decode())
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
            return self._told(letter).encode()
        return b""

    def _told(self, letter: str) -> str:
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
