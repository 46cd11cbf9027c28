"""A Modbus RTU server of another make (modbus-tk) with the bench's registers, standing still, on the line that is named. Prints 0."""

from __future__ import annotations

import struct
import sys

import serial
from modbus_tk import defines
from modbus_tk.modbus_rtu import RtuServer


def f32(value: float) -> list[int]:
    return list(struct.unpack(">HH", struct.pack(">f", value)))


def main() -> None:
    server = RtuServer(serial.Serial(sys.argv[1], 19_200))
    server.start()
    unit = server.add_slave(1)
    unit.add_block("inputs", defines.READ_INPUT_REGISTERS, 0, 202)
    unit.add_block("orders", defines.HOLDING_REGISTERS, 0, 201)
    unit.set_values("inputs", 0, [0x5E31, 1, 0, 0, *f32(-12.5), *f32(0.125), *f32(100.0), 0, 7, *f32(0.0), *f32(2000.0)])
    sys.stdout.write("0\n")
    sys.stdout.flush()
    sys.stdin.readline()


if __name__ == "__main__":
    main()
