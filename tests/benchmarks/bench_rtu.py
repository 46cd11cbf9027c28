"""10,000 readings over Modbus RTU while a part of the answers comes late: how many were the answer to another request?

    python tests/benchmarks/bench_rtu.py [--readings 10000] [--late 0.03] [--master semlive|pymodbus]

A device on a pseudo-terminal, in a process of its own, answers in order; register k holds 1000 + k. Readings ask for 1 to 4 registers
anywhere, so that a late answer often has the form of the one that is waited for. An answer that is late comes after 1.1 to 6 times the
time-out. A reading is right, refused (a reported error), or wrong. `--master pymodbus` does the same with that library's client,
without retries, closed and opened again after each error. Prints one JSON object; the exit code is 1 if a reading was wrong.
"""

from __future__ import annotations

import argparse
import json
import logging
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusException

from semlive.errors import LinkError
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.registers import Kind
from semlive_drivers.modbus.rtu.line import RtuLine
from semlive_drivers.modbus.rtu.link import RtuLink
from semlive_drivers.serial_port import SerialSettings

TIMEOUT_S = 0.04
REGISTERS = 60
LINKS = Path(__file__).resolve().parents[1] / "contract" / "links"

_DEVICE = """
import random, sys
sys.path.insert(0, sys.argv[1])
from emulated import Device, over_rtu
chance, part, timeout_s = random.Random(int(sys.argv[2])), float(sys.argv[3]), float(sys.argv[4])
late = lambda: timeout_s * chance.uniform(1.1, 6.0) if chance.random() < part else 0.0
with over_rtu({1: Device({k: 1000 + k for k in range(int(sys.argv[5]))})}, late) as path:
    print(path, flush=True)
    sys.stdin.readline()
"""

Read = Callable[[int, int], list[int] | None]


def semlive_master(path: str) -> Read:
    """Our own master; None for a reading that is refused."""
    line = RtuLine(SerialSettings(port=path, baud=115_200), TIMEOUT_S)
    link = RtuLink(line, 1, (Block(Kind.HOLDING, 0, 8),))

    def read(address: int, count: int) -> list[int] | None:
        try:
            return list(link.read(Block(Kind.HOLDING, address, count)))
        except LinkError:
            while not link.resync():
                pass
            return None

    return read


def pymodbus_master(path: str) -> Read:
    """The library's client, as it is often used."""
    logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)
    client = ModbusSerialClient(path, baudrate=115_200, timeout=TIMEOUT_S, retries=0)
    client.connect()

    def read(address: int, count: int) -> list[int] | None:
        try:
            answer = client.read_holding_registers(address, count=count, device_id=1)
            return None if answer.isError() else list(answer.registers)
        except ModbusException:
            client.close()
            client.connect()
            return None

    return read


def campaign(readings: int, late: float, master: str, seed: int = 1) -> dict[str, float | int | str]:
    """Read, and count."""
    command = [sys.executable, "-c", _DEVICE, str(LINKS), str(seed), str(late), str(TIMEOUT_S), str(REGISTERS)]
    chance, count = random.Random(seed), {"right": 0, "refused": 0, "wrong": 0}
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as device:
        assert device.stdout is not None
        assert device.stdin is not None
        read = {"semlive": semlive_master, "pymodbus": pymodbus_master}[master](device.stdout.readline().strip())
        began_s = time.monotonic()
        for _ in range(readings):
            address, length = chance.randrange(REGISTERS - 4), chance.randrange(1, 5)
            printed = read(address, length)
            truth = list(range(1000 + address, 1000 + address + length))
            count["refused" if printed is None else "right" if printed == truth else "wrong"] += 1
        took_s = time.monotonic() - began_s
        device.stdin.close()
    return {"master": master, "readings": readings, "late": late, **count, "wall_s": round(took_s, 1)}


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--readings", type=int, default=10_000)
    parser.add_argument("--late", type=float, default=0.03, help="part of the answers that comes late")
    parser.add_argument("--master", choices=("semlive", "pymodbus"), default="semlive")
    options = parser.parse_args()
    found = campaign(options.readings, options.late, options.master)
    sys.stdout.write(json.dumps(found) + "\n")
    return int(found["wrong"] != 0)


if __name__ == "__main__":
    sys.exit(main())
