"""Devices that reply in lines of text, written from the makers' command lists: a test stand, an amplifier, force gauges, a drive."""

from __future__ import annotations

import math
import re
from typing import Protocol

from second_machine import Machine
from second_settings import FAULT, MOVING
from unit_registers import Note


class TextDevice(Protocol):
    """A device on a serial line of text."""

    def receive(self, data: bytes) -> bytes:
        """Take bytes; returns the bytes of all replies."""
        ...


class Mark10Stand:
    """A Mark-10 ESM303 with a force gauge: single letters without a line end, limits and speed with fixed digits.

    Args:
        machine: what it moves.
        note: writes a line of the log.
    """

    _COMMAND = re.compile(rb"e(?P<speed>\d{4}\.\d)|h(?P<upper>[-+]?\d{3}\.\d\d)|g(?P<lower>[-+]?\d{3}\.\d\d)|(?P<letter>[npavwludscmo])")
    _BEGINNING = re.compile(rb"e[\d.]{0,5}$|[hg][-+]?[\d.]{0,5}$")

    def __init__(self, machine: Machine, note: Note) -> None:
        self._machine, self._note = machine, note
        self._received = b""
        self._speed_mm_min, self._upper_mm, self._lower_mm = 0.0, 0.0, 0.0
        self._mode, self._up, self._zero_mm = "M", True, 0.0

    def forget(self) -> None:
        """A restart: speed, limits and mode are forgotten, and the travel counts from 0 again."""
        self._zero_mm = self._machine.extension_mm
        self._received, self._speed_mm_min, self._upper_mm, self._lower_mm, self._mode = b"", 0.0, 0.0, 0.0, "M"

    def receive(self, data: bytes) -> bytes:
        """Carry out commands as soon as they are complete."""
        self._received += data
        replies = b""
        while self._received:
            match = self._COMMAND.match(self._received)
            if match is None:
                if not self._BEGINNING.match(self._received):
                    self._note(f"NOT UNDERSTOOD {self._received[:1]!r}")
                    self._received = self._received[1:]
                    continue
                break
            self._received = self._received[match.end() :]
            for name in ("speed", "upper", "lower"):
                if match[name]:
                    self._set(name, float(match[name]))
            if match["letter"]:
                replies += self._letter(match["letter"].decode())
        return replies

    def _set(self, name: str, value: float) -> None:
        if self._machine.switches.wignore:
            return
        if name == "speed":
            self._speed_mm_min = value
        elif name == "upper":
            self._upper_mm = value
        else:
            self._lower_mm = value

    def _letter(self, letter: str) -> bytes:
        shown = self._machine.shown()
        match letter:
            case "n":
                return f"{shown.extension_mm - self._zero_mm:.2f} mm\r\n{shown.force_n:.1f} N\r\n".encode()
            case "p":
                moving = shown.state == MOVING
                limit = " UL" if not moving and shown.extension_mm - self._zero_mm >= self._upper_mm - 0.005 and self._mode == "L" else ""
                return f"{('U' if self._up else 'D') if moving else 'S'} {self._mode}{limit}\r\n".encode()
            case "a":
                return f"{self._speed_mm_min:.1f} mm/min\r\n".encode()
            case "v":
                return f"{self._upper_mm:.2f} mm\r\n".encode()
            case "w":
                return f"{self._lower_mm:.2f} mm\r\n".encode()
            case "l":
                self._mode = "L"
            case "m":
                self._mode = "M"
            case "s":
                self._note("REQ s <STOP>")
                self._note("STOPPED" if self._machine.stop() else "STOP ignored")
            case "u" | "d":
                self._go(letter == "u", shown.state)
            case _:
                pass
        return b""

    def _go(self, up: bool, state: int) -> None:
        if state == FAULT or self._machine.switches.wignore:
            return
        end_mm = self._upper_mm if up else self._lower_mm
        way_mm = end_mm - (self._machine.extension_mm - self._zero_mm)
        if way_mm * (1 if up else -1) <= 0 or self._mode != "L":
            return
        self._up = up
        self._machine.travel(way_mm, self._speed_mm_min / 60.0)
        self._note(f"MOVE dir={1 if up else 2} travel={abs(way_mm):.5f} speed={self._speed_mm_min / 60.0:.5f}")


class MantracourtAmplifier:
    """A Mantracourt DSC strain-gage amplifier: ``!001:SYS?`` is answered with the load, ``!001:STAT?`` with its flags.

    Args:
        machine: whose load it measures.
    """

    _BELOW_RANGE, _BEYOND_RANGE, _BRIDGE = 1 << 8, 1 << 9, 1 << 11
    RANGE_N = 1000.0

    def __init__(self, machine: Machine, note: Note) -> None:
        self._machine, self._note = machine, note
        self._received = b""

    def forget(self) -> None:
        """A restart: what was received is forgotten."""
        self._received = b""

    def receive(self, data: bytes) -> bytes:
        """Answer every complete request of station 1."""
        self._received += data
        replies = b""
        while b"\r" in self._received:
            request, _, self._received = self._received.partition(b"\r")
            if request.startswith(b"!001:"):
                replies += self._answer(request[5:].decode("ascii", errors="replace")) + b"\r"
        return replies

    def _answer(self, request: str) -> bytes:
        force_n = self._machine.shown().force_n
        match request:
            case "STN?":
                return b"1"
            case "SYS?":
                return b"0.000" if math.isnan(force_n) else f"{min(max(force_n, -self.RANGE_N), self.RANGE_N):.3f}".encode()
            case "STAT?":
                flags = self._BRIDGE if math.isnan(force_n) else self._BEYOND_RANGE if force_n > self.RANGE_N else 0
                return str(flags | (self._BELOW_RANGE if force_n < -self.RANGE_N else 0)).encode()
            case _:
                self._note(f"NOT UNDERSTOOD {request}")
                return b"?"


_REQUESTS = {"imada": (b"D", b"E\r"), "mark10": (b"?C", b"*10\r\n"), "mettler": (b"SI", b"ES\r\n")}
"""Request of a force gauge by its make, and the reply to any other."""


class ForceGauge:
    """A device that answers one request with its present reading, until a carriage return.

    Args:
        machine: whose load it measures.
        note: writes a line of the log.
        make: ``imada`` (DST: reply to ``D``), ``mark10`` (reply to ``?C``) or ``mettler`` (MT-SICS: net weight in kg, reply to ``SI``).
    """

    RANGE_N = 1000.0

    def __init__(self, machine: Machine, note: Note, make: str) -> None:
        self._machine, self._note, self._make = machine, note, make
        self._received = b""

    def forget(self) -> None:
        """A restart: what was received is forgotten."""
        self._received = b""

    def receive(self, data: bytes) -> bytes:
        """Answer every complete request."""
        self._received += data
        replies = b""
        while b"\r" in self._received:
            request, _, self._received = self._received.partition(b"\r")
            replies += self._answer(request.strip(b"\n"))
        return replies

    def _answer(self, request: bytes) -> bytes:
        force_n = self._machine.shown().force_n
        beyond = math.isnan(force_n) or abs(force_n) > self.RANGE_N
        expected, other = _REQUESTS[self._make]
        if request != expected:
            self._note(f"NOT UNDERSTOOD {request!r}")
            return other
        match self._make:
            case "imada":
                return b"+999.99NTE\r" if beyond else f"{force_n:+07.2f}NTO\r".encode()
            case "mark10":
                return b"*11\r\n" if beyond else f"{force_n:.2f} N\r\n".encode()
            case _:
                if beyond:
                    return b"S I\r\n" if math.isnan(force_n) else b"S +\r\n" if force_n > 0 else b"S -\r\n"
                return f"S D {force_n / 9.80665:10.4f} kg\r\n".encode()


class MercuryController:
    """A PI C-863 with the General Command Set 2.0: commands in lines, status by the character 4, its axis with servo on and referenced.

    Args:
        machine: what it moves.
        note: writes a line of the log.
    """

    _ON_TARGET, _IN_MOTION, _SERVO, _ERROR = 1 << 15, 1 << 13, 1 << 12, 1 << 8
    _UNKNOWN_COMMAND, _STOPPED_BY_COMMAND, _BEYOND_LIMIT = 2, 10, 7
    _LIMIT_MM = 25.0

    def __init__(self, machine: Machine, note: Note) -> None:
        self._machine, self._note = machine, note
        self._received = b""
        self._speed_mm_s, self._error, self._zero_mm, self._servo = 1.0, 0, 0.0, True

    def forget(self) -> None:
        """A restart: the servo is off, the speed is the default, and the position counts from 0."""
        self._zero_mm = self._machine.extension_mm
        self._received, self._speed_mm_s, self._error, self._servo = b"", 1.0, 0, False

    def receive(self, data: bytes) -> bytes:
        """Answer status characters at once and every complete line."""
        self._received += data
        replies = b""
        while self._received:
            if self._received[:1] == b"\x04":
                self._received = self._received[1:]
                replies += self._status()
            elif b"\n" in self._received:
                line, _, self._received = self._received.partition(b"\n")
                replies += self._line(line.decode("ascii", errors="replace").split())
            else:
                break
        return replies

    def _status(self) -> bytes:
        moving = self._machine.shown().state == MOVING
        bits = (self._SERVO if self._servo else 0) | (self._IN_MOTION if moving else self._ON_TARGET) | (self._ERROR if self._error else 0)
        return f"0x{bits:04X}\n".encode()

    def _line(self, words: list[str]) -> bytes:
        match words:
            case ["POS?", "1"]:
                return f"1={self._machine.shown().extension_mm - self._zero_mm:.4f}\n".encode()
            case ["VEL?", "1"]:
                return f"1={self._speed_mm_s:.4f}\n".encode()
            case ["ERR?"]:
                error, self._error = self._error, 0
                return f"{error}\n".encode()
            case ["VEL", "1", value]:
                if not self._machine.switches.wignore:
                    self._speed_mm_s = float(value)
            case ["MOV", "1", value]:
                self._go(float(value))
            case ["HLT", "1"]:
                self._error = self._STOPPED_BY_COMMAND
                self._note("REQ HLT <STOP>")
                self._note("STOPPED" if self._machine.stop() else "STOP ignored")
            case _:
                self._error = self._UNKNOWN_COMMAND
                self._note(f"NOT UNDERSTOOD {words}")
        return b""

    def _go(self, end_mm: float) -> None:
        if abs(end_mm) > self._LIMIT_MM or not self._servo or self._machine.shown().state == FAULT:
            self._error = self._BEYOND_LIMIT
            return
        if self._machine.switches.wignore:
            return
        way_mm = end_mm - (self._machine.extension_mm - self._zero_mm)
        self._machine.travel(way_mm, self._speed_mm_s)
        self._note(f"MOVE dir={1 if way_mm >= 0 else 2} travel={abs(way_mm):.5f} speed={self._speed_mm_s:.5f}")
