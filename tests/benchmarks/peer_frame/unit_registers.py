"""The registers of a simulated Modbus unit and the replies to requests for them. Standard library only, shares no code with the product."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence

from second_machine import Machine

Note = Callable[[str], None]


def f32(value: float) -> list[int]:
    """Two registers of a float, high word first."""
    return list(struct.unpack(">HH", struct.pack(">f", value)))


def u32(value: int) -> list[int]:
    """Two registers of a number of 32 bits, high word first; a negative number is in two's complement."""
    return [value >> 16 & 0xFFFF, value & 0xFFFF]


class UnitRegisters:
    """Input and holding registers of one Modbus unit; a device overrides the methods of its own registers.

    Args:
        machine: what the registers show and move.
        note: writes a line of the log.
    """

    def __init__(self, machine: Machine, note: Note) -> None:
        self.machine, self.note = machine, note
        self.holding: dict[int, int] = {}

    def inputs(self) -> Mapping[int, int]:
        """Input registers now."""
        return {}

    def readable(self) -> Mapping[int, int]:
        """Holding registers now, as a client reads them."""
        return self.holding

    def is_stop(self, new: Mapping[int, int]) -> bool:
        """Whether written registers order a stop."""
        return False

    def take(self, new: Mapping[int, int], is_stop: bool) -> None:
        """Act on registers that were written."""

    def forget(self) -> None:
        """Restart: registers are as after power on."""
        self.holding.update(dict.fromkeys(self.holding, 0))

    def show_target(self, target_n: float) -> None:
        """Show a target in N that another program or a person gave."""

    def answer(self, pdu: bytes) -> bytes:
        """The reply to a request, both without unit and check."""
        function, first = pdu[0], struct.unpack(">H", pdu[1:3])[0]
        switches = self.machine.switches
        if function in (3, 4):
            if switches.busy > 0:
                switches.busy -= 1
                return bytes([function | 0x80, 6])
            count = struct.unpack(">H", pdu[3:5])[0]
            registers = self.inputs() if function == 4 else self.readable()
            if any(address not in registers for address in range(first, first + count)):
                return bytes([function | 0x80, 2])
            words = [registers[address] for address in range(first, first + count)]
            if switches.swap and function == 4:
                words = [(word & 0xFF) << 8 | word >> 8 for word in words]
            return bytes([function, 2 * count]) + struct.pack(f">{count}H", *words)
        if function == 16:
            values = struct.unpack(f">{(len(pdu) - 6) // 2}H", pdu[6:])
        elif function == 6:
            values = (struct.unpack(">H", pdu[3:5])[0],)
        else:
            return bytes([function | 0x80, 1])
        return self._written(function, first, values) or pdu[:5]

    def _written(self, function: int, first: int, values: Sequence[int]) -> bytes | None:
        switches, span = self.machine.switches, range(first, first + len(values))
        new = dict(zip(span, values, strict=True))
        is_stop = self.is_stop(new)
        self.note(f"REQ fc={function} ad={first} {' '.join(f'{value:04x}' for value in values)}{' <STOP>' if is_stop else ''}")
        if any(address not in self.holding for address in span):
            return bytes([function | 0x80, 2])
        if switches.excw and not is_stop:
            return bytes([function | 0x80, switches.excw])
        if switches.wignore:
            return None
        self.holding.update(new)
        self.take(new, is_stop)
        return None

    def float_at(self, address: int) -> float:
        """A float in two holding registers, high word first."""
        return struct.unpack(">f", struct.pack(">HH", self.holding[address], self.holding[address + 1]))[0]

    def number_at(self, address: int) -> int:
        """A signed number of 32 bits in two holding registers, high word first."""
        return struct.unpack(">i", struct.pack(">HH", self.holding[address], self.holding[address + 1]))[0]

    def stop_machine(self) -> None:
        """Order the machine to stop and log whether it obeys."""
        self.note("STOPPED" if self.machine.stop() else "STOP ignored")

    def ramp_machine(self, target_n: float, rate_n_s: float) -> float:
        """Order a load; returns the target in N that the machine takes."""
        taken_n = self.machine.ramp(target_n, rate_n_s)
        self.note(f"RAMP to {taken_n:.3f} at {rate_n_s:.3f}")
        return taken_n

    def move_machine(self, travel_mm: float, speed_mm_s: float) -> None:
        """Order a travel; a positive one pulls."""
        self.machine.travel(travel_mm, speed_mm_s)
        self.note(f"MOVE dir={1 if travel_mm >= 0 else 2} travel={abs(travel_mm):.5f} speed={speed_mm_s:.5f}")
