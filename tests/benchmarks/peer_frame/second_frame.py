"""A second load frame: a Modbus TCP server of its own with a servo, a noisy cell and faults; shares no code with the product.

    python second_frame.py PORT LOG [NAME=VALUE ...]

NAME=VALUE are characters (`Character` in second_machine.py) and fault switches (`Switches`). Modbus on 127.0.0.1:PORT for any number of
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
from typing import cast

sys.path.insert(0, __file__.rpartition("/")[0])

from second_machine import Character, Machine, Switches

_STEP_S = 0.002
_FLOATS = {100: "target", 102: "rate", 110: "travel", 112: "speed"}


def _f32(value: float) -> list[int]:
    return list(struct.unpack(">HH", struct.pack(">f", value)))


class Server:
    """Registers, connections and the log around a machine."""

    def __init__(self, machine: Machine, log: str) -> None:
        self.machine = machine
        self._log = open(log, "w", encoding="utf-8")  # noqa: SIM115
        self._holding = dict.fromkeys(range(100, 116), 0)
        self._holding[105] = 1
        self._writers = set[asyncio.StreamWriter]()

    def note(self, what: str) -> None:
        """A line of the log."""
        one = self.machine
        self._log.write(f"{time.monotonic():.6f} F={one.force_n:.3f} E={one.extension_mm:.5f} mv={int(one.moving)} {what}\n")
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
                if switches.hole:
                    continue
                reply = self._answer(pdu)
                if switches.mute:
                    continue
                await asyncio.sleep(self.machine.reply_latency_s())
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

    def _answer(self, pdu: bytes) -> bytes:
        function, first = pdu[0], struct.unpack(">H", pdu[1:3])[0]
        switches = self.machine.switches
        if function in (3, 4):
            if switches.busy > 0:
                switches.busy -= 1
                return bytes([function | 0x80, 6])
            count = struct.unpack(">H", pdu[3:5])[0]
            known = self._inputs() if function == 4 else self._holding
            if any(address not in known for address in range(first, first + count)):
                return bytes([function | 0x80, 2])
            words = [known[address] for address in range(first, first + count)]
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

    def _inputs(self) -> dict[int, int]:
        shown = self.machine.shown()
        words = [shown.state, *_f32(shown.force_n), *_f32(shown.extension_mm), *_f32(shown.target_n)]
        return dict(enumerate([*words, shown.counter >> 16 & 0xFFFF, shown.counter & 0xFFFF]))

    def _written(self, function: int, first: int, values: tuple[int, ...]) -> bytes | None:
        switches, span = self.machine.switches, range(first, first + len(values))
        new = dict(zip(span, values, strict=True))
        is_stop = new.get(104) == 2 or new.get(114) == 3
        self.note(f"REQ fc={function} ad={first} {' '.join(f'{value:04x}' for value in values)}{' <STOP>' if is_stop else ''}")
        if any(address not in self._holding for address in span):
            return bytes([function | 0x80, 2])
        if switches.excw and not is_stop:
            return bytes([function | 0x80, switches.excw])
        if switches.wignore:
            return None
        self._holding.update(new)
        if new.get(105) == 0 and self.machine.drive_off():
            self.note("DRIVE OFF")
        if 104 in new or 114 in new:
            self._command(new, is_stop)
        return None

    def _command(self, new: dict[int, int], is_stop: bool) -> None:
        value = {name: self._float(address) for address, name in _FLOATS.items()}
        if is_stop:
            self.note("STOPPED" if self.machine.stop() else "STOP ignored")
        elif new.get(104) == 1:
            target_n = self.machine.ramp(value["target"], value["rate"])
            if target_n != value["target"]:
                self._holding[100], self._holding[101] = _f32(target_n)
            self.note(f"RAMP to {target_n:.3f} at {value['rate']:.3f}")
        elif new.get(114) in (1, 2):
            self.machine.travel(value["travel"] * (1 if new[114] == 1 else -1), value["speed"])
            self.note(f"MOVE dir={new[114]} travel={value['travel']:.5f} speed={value['speed']:.5f}")

    def _float(self, address: int) -> float:
        return struct.unpack(">f", struct.pack(">HH", self._holding[address], self._holding[address + 1]))[0]

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
            self._holding.update(dict.fromkeys(self._holding, 0))
        elif name == "settarget":
            self.machine.change_target(value)
            self._holding[100], self._holding[101] = _f32(value)
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
        one = self._server.machine
        text = f"{time.monotonic():.6f} {one.force_n:.4f} {one.extension_mm:.6f} {int(one.moving)} {one.target_n:.3f} {one.rate_n_s:.3f} 0"
        self._transport.sendto(text.encode(), addr)


async def _serve(port: int, log: str, given: dict[str, float]) -> None:
    character = {name: value for name, value in given.items() if name in Character.__dataclass_fields__}
    machine = Machine(Character(**character), Switches())
    server = Server(machine, log)
    for name, value in given.items():
        if name not in character:
            machine.command(name, value)
    loop = asyncio.get_running_loop()
    await loop.create_datagram_endpoint(lambda: Control(server), local_addr=("127.0.0.1", port))
    await asyncio.start_server(server.talk, "127.0.0.1", port)
    server.note("START")
    await server.live()


if __name__ == "__main__":
    asyncio.run(_serve(int(sys.argv[1]), sys.argv[2], {name: float(value) for name, value in (one.split("=") for one in sys.argv[3:])}))
