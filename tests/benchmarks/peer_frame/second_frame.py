"""A second load frame: a Modbus TCP server of its own with a servo, a noisy cell and faults; shares no code with the product.

    python second_frame.py PORT LOG [NAME=VALUE ...]

NAME=VALUE are characters (`Character` in second_settings.py) and fault switches (`Switches`). Modbus on 127.0.0.1:PORT for any number of
clients, commands `NAME VALUE` over UDP at the same port, `?` is answered with time, F, E, motion, target, rate, counter; the log has the
form of the independent frame's. Only the standard library is used.

Input registers, high word first: 0 state (0 still, 1 moving, 2 fault), 1 force f32, 3 extension f32, 5 active target f32, 7 counter u32.
Holding registers: 100 target f32, 102 rate f32, 104 command (1 ramp, 2 stop), 105 drive enable, 106 heartbeat; 110 travel f32,
112 speed f32, 114 command (1 pull, 2 push, 3 stop).
"""

from __future__ import annotations

import asyncio
import struct
import sys
import time
from collections.abc import Callable, Mapping
from typing import cast

sys.path.insert(0, __file__.rpartition("/")[0])

from second_machine import Machine
from second_settings import Character, Switches
from unit_registers import Note, UnitRegisters, f32, u32

_STEP_S = 0.002
_FLOATS = {100: "target", 102: "rate", 110: "travel", 112: "speed"}


class SecondRegisters(UnitRegisters):
    """The registers of the second frame."""

    def __init__(self, machine: Machine, note: Note) -> None:
        super().__init__(machine, note)
        self.holding = dict.fromkeys(range(100, 116), 0)
        self.holding[105] = 1

    def inputs(self) -> dict[int, int]:
        """State, force, extension, active target and counter."""
        shown = self.machine.shown()
        words = [shown.state, *f32(shown.force_n), *f32(shown.extension_mm), *f32(shown.target_n), *u32(shown.counter)]
        return dict(enumerate(words))

    def is_stop(self, new: Mapping[int, int]) -> bool:
        """A command of 2 in load control, of 3 in displacement control."""
        return new.get(104) == 2 or new.get(114) == 3

    def take(self, new: Mapping[int, int], is_stop: bool) -> None:
        """Drive enable and the two commands."""
        if new.get(105) == 0 and self.machine.drive_off():
            self.note("DRIVE OFF")
        if 104 not in new and 114 not in new:
            return
        value = {name: self.float_at(address) for address, name in _FLOATS.items()}
        if is_stop:
            self.stop_machine()
        elif new.get(104) == 1:
            taken_n = self.ramp_machine(value["target"], value["rate"])
            if taken_n != value["target"]:
                self.show_target(taken_n)
        elif new.get(114) in (1, 2):
            self.move_machine(value["travel"] * (1 if new[114] == 1 else -1), value["speed"])

    def show_target(self, target_n: float) -> None:
        """Registers 100 and 101."""
        self.holding[100], self.holding[101] = f32(target_n)


class Server:
    """Connections, the log and the passing of time around a machine and the registers of a unit.

    Args:
        machine: specimen, drive and cell.
        log: file of the log.
        registers: makes the registers of the unit behind Modbus TCP.
    """

    def __init__(self, machine: Machine, log: str, registers: Callable[[Machine, Note], UnitRegisters] = SecondRegisters) -> None:
        self.machine = machine
        self._log = open(log, "w", encoding="utf-8")  # noqa: SIM115
        self.registers = registers(machine, self.note)
        self.link = 1
        self._writers = set[asyncio.StreamWriter]()

    def note(self, what: str) -> None:
        """A line of the log."""
        item = self.machine
        self._log.write(f"{time.monotonic():.6f} F={item.force_n:.3f} E={item.extension_mm:.5f} mv={int(item.moving)} {what}\n")
        self._log.flush()

    # ---- Modbus

    async def talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection."""
        self._writers.add(writer)
        self.note("ACCEPT")
        switches = self.machine.switches
        try:
            while True:
                head = await reader.readexactly(7)
                number, _, length, unit = struct.unpack(">HHHB", head)
                pdu = await reader.readexactly(length - 1)
                if switches.hole and switches.concern(self.link):
                    continue
                reply = self.registers.answer(pdu)
                if switches.mute and switches.concern(self.link):
                    continue
                await asyncio.sleep(self.machine.reply_latency_s(self.link))
                await self._send(writer, number, unit, reply)
        except (asyncio.IncompleteReadError, ConnectionError):
            self.note("CLOSED")
        finally:
            self._writers.discard(writer)
            writer.close()

    async def _send(self, writer: asyncio.StreamWriter, number: int, unit: int, reply: bytes) -> None:
        switches = self.machine.switches
        unit = unit ^ 0x2A if switches.wrongunit else unit
        number = number ^ 0x5A3C if switches.badtid else number
        if switches.wrongfunc:
            reply = bytes([reply[0] ^ 0x01]) + reply[1:]
        if switches.trunc and len(reply) > 4:
            reply = reply[:-2]
        frame = struct.pack(">HHHB", number, 0, len(reply) + 1, unit) + reply
        pieces = [frame[k : k + 1] for k in range(len(frame))] if self.machine.character.pieces else [frame]
        for piece in pieces:
            writer.write(piece)
            await writer.drain()
            if len(pieces) > 1:
                await asyncio.sleep(0)

    # ---- UDP and time

    def command(self, text: str) -> None:
        """A fault switch or a value."""
        name, _, rest = text.partition(" ")
        value = float(rest or 0)
        if name == "drop":
            for writer in list(self._writers):
                writer.transport.abort()
        elif name == "reboot":
            self.machine.reboot()
            self.registers.forget()
        elif name == "settarget":
            self.machine.change_target(value)
            self.registers.show_target(value)
        else:
            self.machine.command(name, value)
        self.note(f"CTL {text}")

    async def live(self) -> None:
        """Let time pass for the machine."""
        while True:
            await asyncio.sleep(_STEP_S)
            if what := self.machine.advance():
                self.note(what)


class Control(asyncio.DatagramProtocol):
    """The UDP side."""

    def __init__(self, server: Server) -> None:
        self._server = server

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the way back."""
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str | int, int]) -> None:
        """A command, or the question for the true state."""
        if not data.startswith(b"?"):
            self._server.command(data.decode().strip())
            return
        true = self._server.machine
        motion = f"{int(true.moving)} {true.target_n:.3f} {true.rate_n_s:.3f} 0"
        text = f"{time.monotonic():.6f} {true.force_n:.4f} {true.extension_mm:.6f} {motion}"
        self._transport.sendto(text.encode(), addr)


def machine_of(given: Mapping[str, float]) -> Machine:
    """A machine with characters and fault switches by name."""
    character = {name: value for name, value in given.items() if name in Character.__dataclass_fields__}
    machine = Machine(Character(**character), Switches())
    for name, value in given.items():
        if name not in character:
            machine.command(name, value)
    return machine


async def _serve(port: int, log: str, given: dict[str, float]) -> None:
    server = Server(machine_of(given), log)
    loop = asyncio.get_running_loop()
    await loop.create_datagram_endpoint(lambda: Control(server), local_addr=("127.0.0.1", port))
    await asyncio.start_server(server.talk, "127.0.0.1", port)
    server.note("START")
    await server.live()


if __name__ == "__main__":
    asyncio.run(_serve(int(sys.argv[1]), sys.argv[2], {name: float(value) for name, value in (item.split("=") for item in sys.argv[3:])}))
