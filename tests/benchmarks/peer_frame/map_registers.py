"""The registers of the devices that semlive ships maps for, written from the makers' register lists. Standard library only.

Nothing here reads a map or shares code with the product: an error of a map shows as a wrong reading or a motion that was not ordered.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

from second_machine import Machine
from second_settings import FAULT, MOVING
from unit_registers import Note, UnitRegisters, f32, u32


class BenchRegisters(UnitRegisters):
    """The bench of docs/reference/bench-registers.md: load control with nonce, counter of readings and a watchdog."""

    OVERLOAD_N = 2000.0

    def __init__(self, machine: Machine, note: Note) -> None:
        super().__init__(machine, note)
        self.holding = dict.fromkeys((*range(8), *range(300, 306)), 0)
        self._beat_s, self._expired = time.monotonic(), False

    def inputs(self) -> Mapping[int, int]:
        """Input registers 0 to 15 and 300."""
        shown = self.machine.shown()
        state = FAULT if self._expired else shown.state
        words = [0x5E31, 1, 2, state, *f32(shown.force_n), *f32(shown.extension_mm), *f32(shown.target_n), *u32(shown.counter)]
        registers = dict(enumerate([*words, *f32(0.0), *f32(self.OVERLOAD_N)]))
        return registers | {300: 2 if self._expired else 0}

    def is_stop(self, new: Mapping[int, int]) -> bool:
        """Command 2 of load control or of displacement control."""
        return new.get(4) == 2 or new.get(304) == 2

    def take(self, new: Mapping[int, int], is_stop: bool) -> None:
        """Heartbeat, watchdog time and commands."""
        if 6 in new or 7 in new:
            self._beat_s = time.monotonic()
        if is_stop:
            self._expired = False
            self.stop_machine()
        elif new.get(4) == 1:
            self._expired = False
            taken_n = self.ramp_machine(self.float_at(0), self.float_at(2))
            if taken_n != self.float_at(0):
                self.show_target(taken_n)

    def show_target(self, target_n: float) -> None:
        """Registers 0 and 1."""
        self.holding[0], self.holding[1] = f32(target_n)

    def pass_time(self) -> None:
        """Stop when the watchdog expires."""
        watchdog_s = 0.1 * self.holding[7]
        if watchdog_s and not self._expired and time.monotonic() > self._beat_s + watchdog_s and not self.machine.switches.nobeat:
            self._expired = True
            self.note("WATCHDOG")
            self.machine.stop()


class GenericRegisters(UnitRegisters):
    """Force, extension and state in input registers 0 to 4; target, rate, command and heartbeat in holding registers 0 to 5."""

    def __init__(self, machine: Machine, note: Note) -> None:
        super().__init__(machine, note)
        self.holding = dict.fromkeys(range(6), 0)

    def inputs(self) -> Mapping[int, int]:
        """Force, extension, state."""
        shown = self.machine.shown()
        return dict(enumerate([*f32(shown.force_n), *f32(shown.extension_mm), shown.state]))

    def is_stop(self, new: Mapping[int, int]) -> bool:
        """Command 2."""
        return new.get(4) == 2

    def take(self, new: Mapping[int, int], is_stop: bool) -> None:
        """The command."""
        if is_stop:
            self.stop_machine()
        elif new.get(4) == 1:
            taken_n = self.ramp_machine(self.float_at(0), self.float_at(2))
            if taken_n != self.float_at(0):
                self.show_target(taken_n)

    def show_target(self, target_n: float) -> None:
        """Registers 0 and 1."""
        self.holding[0], self.holding[1] = f32(target_n)


DIVISIONS = (100, 50, 20, 10, 5, 2, 1, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001)
"""Division of a Laumas display by its code 0 to 18."""
DECIMALS = (0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4)
"""Decimals that belong to each division."""
_CELL_ERROR, _CONVERTER_ERROR, _OVERLOAD, _BEYOND_110_PERCENT, _NEGATIVE = 1, 2, 4, 8, 0x80
_FULL_SCALE_N = 1000.0


class LaumasRegisters(UnitRegisters):
    """A Laumas TLB load-cell transmitter: gross load as a magnitude without its decimal point, sign and errors in the status.

    Attributes:
        division: code of the display's division, 0 to 18.
    """

    division = 9

    def readable(self) -> Mapping[int, int]:
        """Registers 40001 to 40032, of which 40007 to 40009 and 40014 count."""
        force_n, status = self.machine.shown().force_n, 0
        if math.isnan(force_n):
            status, force_n = status | _CELL_ERROR, 0.0
        elif math.isinf(force_n):
            status, force_n = status | _BEYOND_110_PERCENT, 1.1 * _FULL_SCALE_N
        elif abs(force_n) > _FULL_SCALE_N:
            status |= _OVERLOAD | (_BEYOND_110_PERCENT if abs(force_n) > 1.1 * _FULL_SCALE_N else 0)
        step = DIVISIONS[self.division]
        status |= _NEGATIVE if force_n < 0 else 0
        magnitude = round(round(abs(force_n) / step) * step * 10 ** DECIMALS[self.division])
        words = dict.fromkeys(range(32), 0) | {0: 104, 1: 44, 3: 4711, 6: status, 13: 4 << 8 | self.division}
        words[7], words[8] = u32(magnitude)
        words[9], words[10] = words[7], words[8]
        return words


class FlintecRegisters(UnitRegisters):
    """A Flintec DAD 141.1: gross and net load as floats, high word first, and the qualifier, in registers 0x3500 to 0x3504."""

    RANGE_N = 1000.0
    _BELOW, _BEYOND = 1, 2

    def readable(self) -> Mapping[int, int]:
        """The combined result."""
        force_n = self.machine.shown().force_n
        lost = math.isnan(force_n)
        qualifier = self._BEYOND if lost or force_n > self.RANGE_N else self._BELOW if force_n < -self.RANGE_N else 0
        shown_n = self.RANGE_N if lost else min(max(force_n, -self.RANGE_N), self.RANGE_N)
        return dict(enumerate([*f32(shown_n), *f32(shown_n), qualifier], 0x3500))


class SenecaRegisters(UnitRegisters):
    """A Seneca ZE-SG3 in N: unit in register 2, net and gross load as floats, high word first, from register 63; it shows no errors."""

    RANGE_N = 1000.0

    def readable(self) -> Mapping[int, int]:
        """Unit, polarity, loads and status; a broken cell is shown as the end of the range."""
        force_n = self.machine.shown().force_n
        shown_n = self.RANGE_N if math.isnan(force_n) else min(max(force_n, -self.RANGE_N), self.RANGE_N)
        return {2: 5, 3: 0, 77: 0} | dict(enumerate([*f32(shown_n), *f32(shown_n), *f32(0.0)], 63))


class DriveRegisters(UnitRegisters):
    """What drives have in common: one count of travel and of speed.

    Attributes:
        travel_mm: one count of travel, mm.
        speed_mm_s: one count of speed, mm/s.
    """

    travel_mm = 0.0001
    speed_mm_s = 0.0001


class LeadshineRegisters(DriveRegisters):
    """A Leadshine DM-RS or EM-RS: path 0 from 0x6200, trigger 0x6002, motion state 0x1003."""

    speed_mm_s = 0.005

    def __init__(self, machine: Machine, note: Note) -> None:
        super().__init__(machine, note)
        self.holding = dict.fromkeys((0x01BF, 0x1003, 0x2203, 0x6002, *range(0x6200, 0x6208)), 0)
        self.holding[0x01BF] = 2

    def readable(self) -> Mapping[int, int]:
        """Bits of 0x1003: 0 fault, 1 enabled, 2 running, 4 command completed, 5 path completed; 0x6002 shows the state of the path."""
        state = self.machine.shown().state
        word = {FAULT: 0x01, MOVING: 0x06}.get(state, 0x32)
        return self.holding | {0x1003: word, 0x2203: 0x0E0 if state == FAULT else 0, 0x6002: 0x100 if state == MOVING else 0}

    def is_stop(self, new: Mapping[int, int]) -> bool:
        """Trigger 0x40 is the quick stop."""
        return new.get(0x6002) == 0x40

    def take(self, new: Mapping[int, int], is_stop: bool) -> None:
        """Trigger 0x10 begins path 0; mode 0x41 is relative, 0x01 absolute."""
        if is_stop:
            self.stop_machine()
        elif new.get(0x6002) == 0x10:
            if self.holding[0x6200] != 0x41:
                self.note(f"MODE {self.holding[0x6200]:#x} is not relative")
                return
            self.move_machine(self.number_at(0x6201) * self.travel_mm, self.holding[0x6203] * self.speed_mm_s)


class OrientalRegisters(DriveRegisters):
    """An Oriental Motor AZ driver: direct data operation from 0x58, remote inputs 0x7C, remote outputs 0x7E, position 0xCC."""

    def __init__(self, machine: Machine, note: Note) -> None:
        super().__init__(machine, note)
        self.holding = dict.fromkeys((*range(0x58, 0x6A), *range(0x7C, 0x82), *range(0xC6, 0xD8)), 0)

    def readable(self) -> Mapping[int, int]:
        """Remote outputs: READY 5, ALM-A 7, MOVE 13; the trigger returns to 0 by itself."""
        shown = self.machine.shown()
        outputs = {FAULT: 1 << 7, MOVING: 1 << 13}.get(shown.state, 1 << 5)
        words = dict(self.holding)
        words[0x7E], words[0x7F] = u32(outputs)
        words[0x80], words[0x81] = u32(0x30 if shown.state == FAULT else 0)
        words[0x66], words[0x67] = 0, 0
        words[0xCC], words[0xCD] = u32(round(shown.extension_mm / self.travel_mm))
        return words

    def is_stop(self, new: Mapping[int, int]) -> bool:
        """Remote input 5 is STOP, 6 is FREE."""
        return bool(new.get(0x7D, 0) & 0x60)

    def take(self, new: Mapping[int, int], is_stop: bool) -> None:
        """Inputs, and the trigger of direct data operation."""
        if is_stop:
            if new[0x7D] & 0x40 and self.machine.drive_off():
                self.note("FREE")
            self.stop_machine()
        elif 0x67 in new and self.number_at(0x66) == 1:
            if self.number_at(0x5A) != 3 or self.holding[0x7D] & 0x60:
                self.note(f"TYPE {self.number_at(0x5A)} with inputs {self.holding[0x7D]:#x} does not move")
                return
            self.move_machine(self.number_at(0x5C) * self.travel_mm, self.number_at(0x5E) * self.speed_mm_s)


class WagoRegisters(UnitRegisters):
    """The watchdog of a WAGO 750 coupler, whose outputs enable the drive: time 0x1000, trigger 0x1003, status 0x1006."""

    def __init__(self, machine: Machine, note: Note) -> None:
        super().__init__(machine, note)
        self.holding = dict.fromkeys(range(0x1000, 0x100B), 0)
        self._beat_s, self._status = time.monotonic(), 0

    def readable(self) -> Mapping[int, int]:
        """Status 0 off, 1 running, 2 expired."""
        return self.holding | {0x1006: self._status}

    def forget(self) -> None:
        """A restart of the drive does not restart the coupler."""

    def take(self, new: Mapping[int, int], is_stop: bool) -> None:
        """A change of the trigger feeds the watchdog and starts it."""
        if 0x1003 in new and self._status != 2:
            self._beat_s, self._status = time.monotonic(), 1

    def pass_time(self) -> None:
        """Outputs fall when the watchdog expires."""
        if self._status == 1 and self.holding[0x1000] and time.monotonic() > self._beat_s + 0.1 * self.holding[0x1000]:
            self._status, self.machine.powered = 2, False
            self.note("WATCHDOG")
            self.machine.drive_off()
