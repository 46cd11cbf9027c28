"""The bench over serial lines: Modbus RTU spoken by pymodbus and by hand, single letters by hand."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import select
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from pymodbus.client import ModbusSerialClient

from semlive_simulators.load_frame.ascii_stand import AsciiTestStand
from semlive_simulators.load_frame.registers import f32, read_f32
from semlive_simulators.load_frame.rtu import STAGE_UNIT, crc16
from semlive_simulators.load_frame.serial_lines import ascii_line, rtu_line
from semlive_simulators.load_frame.server import UNIT
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.machine import LoadTrain

from ..waiting import wait_until
from .running_bench import running_bench

RATE = 50.0
PAPER = load_scenario("paper_x200")
SMALL = dataclasses.replace(PAPER, scan=dataclasses.replace(PAPER.scan, width_px=64, height_px=55, frame_time_s=6.0))


@dataclass
class Lines:
    """Both lines of one bench; nothing scans."""

    rtu: str
    serial: str
    stand: AsciiTestStand
    machine: LoadTrain


@pytest.fixture
def lines(tmp_path: Path) -> Iterator[Lines]:
    with running_bench(SMALL, RATE, tmp_path) as bench:
        troubles = bench.registers.line_faults
        with rtu_line(bench.port, UNIT, troubles) as rtu, ascii_line(bench.machine, bench.clock.now_ns, troubles) as (serial, stand):
            yield Lines(rtu, serial, stand, bench.machine)


@contextlib.contextmanager
def opened(path: str) -> Iterator[int]:
    handle = os.open(path, os.O_RDWR | os.O_NOCTTY)
    yield handle
    os.close(handle)


SILENCE_S = 0.15


def reply(handle: int, sent: bytes, within_s: float = 20.0, lines: int = 0) -> bytes:
    """What comes back until the line has been silent for a while; a busy computer may need as long as given for the first byte or line."""
    os.write(handle, sent)
    answer = b""
    while select.select([handle], [], [], SILENCE_S if answer and answer.count(b"\n") >= lines else within_s)[0]:
        answer += os.read(handle, 4096)
    return answer


def test_pymodbus_reads_and_drives_over_rtu(lines: Lines) -> None:
    client = ModbusSerialClient(lines.rtu, baudrate=19_200, timeout=20, retries=0)
    assert client.connect()
    answer = client.read_input_registers(0, count=16, device_id=UNIT)
    assert answer.registers[:4] == [0x5E31, 1, 3, 0]
    assert not client.write_registers(0, [*f32(150.0), *f32(100.0), 1, 7, 0, 0], device_id=UNIT).isError()
    assert client.read_holding_registers(5, count=1, device_id=UNIT).registers == [7]
    wait_until(lambda: client.read_input_registers(3, count=1, device_id=UNIT).registers == [0])
    assert read_f32(client.read_input_registers(4, count=2, device_id=UNIT).registers) == pytest.approx(150.0, abs=8)
    assert client.read_input_registers(16, count=1, device_id=UNIT).exception_code == 2
    client.close()


def framed(unit: int, request: bytes) -> bytes:
    return bytes([unit]) + request + crc16(bytes([unit]) + request)


def test_the_check_bytes_are_those_of_the_specification() -> None:
    assert crc16(bytes.fromhex("010400000004")) == bytes.fromhex("f1c9")
    assert crc16(b"123456789") == bytes.fromhex("374b")  # CRC-16/MODBUS of the catalogue: 0x4B37


def test_bytes_on_the_line_and_silence_where_a_device_keeps_silent(lines: Lines) -> None:
    read = struct.pack(">BHH", 4, 0, 2)
    with opened(lines.rtu) as line:
        assert reply(line, framed(UNIT, read)) == framed(UNIT, bytes([4, 4]) + struct.pack(">HH", 0x5E31, 1))
        assert reply(line, framed(2, read), SILENCE_S) == b""  # another unit
        assert reply(line, framed(UNIT, read)[:-1] + b"\0", SILENCE_S) == b""  # damaged
        assert reply(line, b"\x01", SILENCE_S) == b""
        assert reply(line, framed(0, struct.pack(">BHH", 6, 5, 99)), SILENCE_S) == b""  # a write to everybody
        assert reply(line, framed(UNIT, struct.pack(">BHH", 3, 5, 1))) == framed(UNIT, bytes([3, 2, 0, 99]))
        assert reply(line, framed(UNIT, struct.pack(">BHH", 1, 0, 1))) == framed(UNIT, bytes([0x81, 1]))


def test_the_stage_answers_as_a_second_device_too(lines: Lines) -> None:
    with opened(lines.rtu) as line:
        assert reply(line, framed(STAGE_UNIT, struct.pack(">BHH", 4, 0, 2))) == framed(
            STAGE_UNIT, bytes([4, 4]) + struct.pack(">HH", 0x5E31, 1)
        )
        assert reply(line, framed(STAGE_UNIT, struct.pack(">BHH", 4, 100, 1))) == framed(STAGE_UNIT, bytes([4, 2, 0, 0]))
        assert reply(line, framed(STAGE_UNIT, struct.pack(">BHH", 4, 3, 2))) == framed(STAGE_UNIT, bytes([0x84, 2]))  # the load frame's
        assert reply(line, framed(STAGE_UNIT, struct.pack(">BHH", 6, 4, 2))) == framed(STAGE_UNIT, bytes([0x86, 2]))


def test_an_answer_takes_the_time_of_its_bytes_at_19200_baud(lines: Lines) -> None:
    request = framed(UNIT, struct.pack(">BHH", 4, 0, 16))
    with opened(lines.rtu) as line:
        reply(line, request)
        began = time.monotonic()
        os.write(line, request)
        select.select([line], [], [], 2.0)
        took_s = time.monotonic() - began
    assert took_s > (8 + 37) * 10 / 19_200


def test_a_stand_that_obeys_letters(lines: Lines) -> None:
    with opened(lines.serial) as line:
        assert reply(line, b"p") == b"S M\r\n"
        travel, force = reply(line, b"n", lines=2).decode().splitlines()
        assert travel.endswith(" mm")
        assert force.endswith(" N")
        assert abs(float(travel.split()[0])) < 0.002
        assert reply(line, b"e0002.4a") == b"2.4 mm/min\r\n"
        assert reply(line, b"e0000.2a") == b"0.5 mm/min\r\n"  # the slowest: a faster one is at its force limit before a busy computer looks
        assert reply(line, b"u", 0.02) == b""
        assert reply(line, b"p") == b"U M\r\n"
        wait_until(lambda: float(reply(line, b"n", lines=2).split()[2]) > 300.0)
        assert reply(line, b"s", 0.02) == b""
        assert reply(line, b"p") == b"S M\r\n"
        held = [float(word) for word in reply(line, b"n", lines=2).split()[::2]]
        later = [float(word) for word in reply(line, b"n", lines=2).split()[::2]]
        assert later[0] == pytest.approx(held[0], abs=0.002)
        assert later[1] == pytest.approx(held[1], abs=10)
        # Stiffness of specimen and machine in series.
        assert held[1] / held[0] == pytest.approx(1 / (1 / PAPER.specimen.stiffness_n_mm + 1 / 8000), rel=0.05)
        # In one breath: at fifty times real time it is back at zero after 40 ms.
        assert reply(line, b"dp") == b"D M\r\n"
        reply(line, b"s", 0.02)


def test_a_travel_limit_stops_it_and_lets_it_go_back(lines: Lines) -> None:
    with opened(lines.serial) as line:
        assert reply(line, b"h000.05g-000.05lv") == b"0.05 mm\r\n"
        reply(line, b"e0001.0u", 0.02)

        def stopped() -> bool:
            lines.stand.watch_limits()
            return b"S" in reply(line, b"p")

        wait_until(stopped)
        assert reply(line, b"p") == b"S L UL\r\n"
        reply(line, b"u", 0.02)
        assert reply(line, b"p") == b"S L UL\r\n"
        assert reply(line, b"dp").startswith(b"D L")
        reply(line, b"s", 0.02)


def test_letters_that_mean_nothing_are_passed_over(lines: Lines) -> None:
    with opened(lines.serial) as line:
        assert reply(line, b"\x00?!Q\r\nk y", SILENCE_S) == b""
        assert reply(line, b"p\r") == b"S M\r\n"
