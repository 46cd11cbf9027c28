"""A Modbus TCP server of another make (modbus-tk) with the bench's registers, standing still. Prints its port."""

from __future__ import annotations

import struct
import sys
import time

from modbus_tk import defines
from modbus_tk.modbus_tcp import TcpServer


def f32(value: float) -> list[int]:
    return list(struct.unpack(">HH", struct.pack(">f", value)))


def main() -> None:
    server = TcpServer(port=0, address="127.0.0.1")
    server.start()
    while server._sock is None or server._sock.getsockname()[1] == 0:
        time.sleep(0.01)
    unit = server.add_slave(1)
    unit.add_block("inputs", defines.READ_INPUT_REGISTERS, 0, 202)
    unit.add_block("orders", defines.HOLDING_REGISTERS, 0, 201)
    load_frame = [0x5E31, 1, 0, 0, *f32(-12.5), *f32(0.125), *f32(100.0), 0, 7, *f32(0.0), *f32(2000.0)]
    unit.set_values("inputs", 0, load_frame)
    unit.set_values("inputs", 100, [1, *f32(10.5), *f32(-3.25), 0, 9])
    sys.stdout.write(f"{server._sock.getsockname()[1]}\n")
    sys.stdout.flush()
    sys.stdin.readline()
    server.stop()


if __name__ == "__main__":
    main()
