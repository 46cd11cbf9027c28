"""A Modbus TCP server in a process of its own, after docs/reference/bench-registers.md, that misbehaves on request.

Written independently of the drivers and the simulators. Prints its port. Misbehaviour is selected by holding register 900:
1 frozen counter, 2 NaN force, 3 takes no commands, 4 a motion state that does not exist, 5 refuses writes (exception 6), 6 wrong identity.
Force may be set through 902-903. Holding register 910 counts commands to the load frame, 911 keeps the last one,
912 how often the heartbeat changed.
"""

from __future__ import annotations

import asyncio
import math
import struct
import sys
import time

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice


def f32(value: float) -> list[int]:
    return list(struct.unpack(">HH", struct.pack(">f", value)))


def as_f32(words: list[int]) -> float:
    return struct.unpack(">f", struct.pack(">HH", *words))[0]


class Registers:
    def __init__(self) -> None:
        self.mode = 0
        self.force_n = 0.0
        self.target_n = 0.0
        self.xy_um = [0.0, 0.0]
        self.moving_until_s = 0.0
        self.stage_until_s = 0.0
        self.readings = 0
        self.commands = 0
        self.last_command = 0
        self.beats = 0

    async def action(
        self, function: int, start: int, address: int, count: int, registers: list[int], values: list | None
    ) -> ExcCodes | None:
        if function == 4:
            self.readings += self.mode != 1
            registers[0:16] = self.load_frame()
            registers[100:107] = self.stage()
            registers[200:202] = [0, 0]
        elif function == 3:
            if self.mode == 3:
                registers[0:6] = registers[100:106] = [0] * 6
            registers[910:913] = [self.commands, self.last_command, self.beats]
        elif function == 16 and values is not None:
            return self.written(address, [int(v) for v in values], registers)
        return None

    def written(self, address: int, values: list[int], before: list[int]) -> ExcCodes | None:
        if address >= 900:
            if address == 900:
                self.mode = values[0]
            if address == 902:
                self.force_n = as_f32(values)
            return None
        if self.mode == 5:
            return ExcCodes.DEVICE_BUSY
        if address == 6 and values[0] != before[6]:
            self.beats += 1
        if address == 0 and len(values) >= 6 and self.mode != 3:
            self.commands += 1
            self.last_command = values[4]
            if values[4] == 1:
                self.force_n = self.target_n = as_f32(values[0:2])
                self.moving_until_s = time.monotonic() + 1.0
            else:
                self.moving_until_s = 0.0
        if address == 100:
            self.stage_until_s = time.monotonic() + 1.0 if values[4] == 1 else 0.0
            if values[4] == 1:
                self.xy_um = [as_f32(values[0:2]), as_f32(values[2:4])]
        return None

    def load_frame(self) -> list[int]:
        moving = 9 if self.mode == 4 else int(time.monotonic() < self.moving_until_s)
        force = math.nan if self.mode == 2 else self.force_n
        head = [0x1234 if self.mode == 6 else 0x5E31, 1, 0b11, moving]
        return [*head, *f32(force), *f32(0.25), *f32(self.target_n), self.readings >> 16, self.readings & 0xFFFF, *f32(0.0), *f32(4300.0)]

    def stage(self) -> list[int]:
        moving = int(time.monotonic() < self.stage_until_s)
        return [moving, *f32(self.xy_um[0]), *f32(self.xy_um[1]), self.readings >> 16, self.readings & 0xFFFF]


async def main(port: int) -> None:
    table = [SimData(0, count=1000, values=0, datatype=DataType.REGISTERS)]
    bits = [SimData(0, count=1, values=False, datatype=DataType.BITS)]
    device = SimDevice(id=1, simdata=(bits, list(bits), table, list(table)), action=Registers().action)
    server = ModbusTcpServer(device, address=("127.0.0.1", port))
    await server.serve_forever(background=True)
    sys.stdout.write(f"{server.transport.sockets[0].getsockname()[1]}\n")
    sys.stdout.flush()
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]) if len(sys.argv) > 1 else 0))
