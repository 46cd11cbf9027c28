"""The bench's Modbus server, spoken to by pymodbus's own client and by hand, byte by byte."""

from __future__ import annotations

import dataclasses
import socket
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient

from semlive_simulators.load_frame.registers import f32, read_f32
from semlive_simulators.load_frame.server import BenchRegisters
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.machine import LoadTrain

from ..waiting import wait_until
from .running_bench import running_bench

RATE = 100.0
DATATYPE = ModbusTcpClient.DATATYPE


@dataclass
class Served:
    """A bench without its loop, behind a client."""

    client: ModbusTcpClient
    registers: BenchRegisters
    machine: LoadTrain
    port: int

    def inputs(self, address: int, count: int) -> list[int]:
        answer = self.client.read_input_registers(address, count=count, device_id=1)
        assert not answer.isError(), answer
        return list(answer.registers)

    def force_n(self) -> float:
        return read_f32(self.inputs(4, 2))


@pytest.fixture(params=["continuous", "triggered"])
def mode(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def bench(tmp_path: Path, mode: str) -> Iterator[Served]:
    paper = load_scenario("paper_x200")
    scenario = dataclasses.replace(paper, scan=dataclasses.replace(paper.scan, width_px=256, height_px=221, frame_time_s=6.63))
    failures: list[BaseException] = []
    with running_bench(scenario, RATE, tmp_path, mode == "triggered", failures.append) as parts:
        if mode == "triggered":
            parts.sem.start()
        client = ModbusTcpClient("127.0.0.1", port=parts.port, timeout=20, retries=0)
        assert client.connect()
        yield Served(client, parts.registers, parts.machine, parts.port)
        client.close()
        if mode == "triggered":
            parts.sem.stop()
    assert failures == []


@pytest.mark.parametrize("mode", ["continuous"], indirect=True)
def test_the_complete_protocol_with_the_load_frame(bench: Served) -> None:
    first = bench.inputs(0, 16)
    assert first[:4] == [0x5E31, 1, 3, 0]
    assert abs(read_f32(first[4:6])) < 6
    assert read_f32(first[14:16]) == 4300.0
    block = [*f32(200.0), *f32(1.0), 1, 77, 1, 0]  # two seconds, in which it is seen moving
    assert not bench.client.write_registers(0, block, device_id=1).isError()
    assert bench.client.read_holding_registers(0, count=8, device_id=1).registers == block
    assert bench.inputs(3, 1) == [1]
    assert read_f32(bench.inputs(8, 2)) == 200.0
    wait_until(lambda: bench.inputs(3, 1) == [0])
    assert abs(bench.force_n() - 200.0) < 8
    extension_mm = read_f32(bench.inputs(6, 2))
    assert 0.03 < extension_mm < 0.05
    second = bench.inputs(0, 16)
    count = (second[10] << 16) + second[11]
    assert count > (first[10] << 16) + first[11]


@pytest.mark.parametrize("mode", ["continuous"], indirect=True)
def test_stop_acts_at_once_and_holds(bench: Served) -> None:
    bench.client.write_registers(0, [*f32(4000.0), *f32(10.0), 1, 1, 0, 0], device_id=1)
    wait_until(lambda: bench.force_n() > 50)
    bench.client.write_register(4, 2, device_id=1)
    assert bench.inputs(3, 1) == [0]
    held_n = bench.force_n()
    assert 40 < held_n < 3800  # not at its target, however late the command came
    time.sleep(0.05)
    assert abs(bench.force_n() - held_n) < 10
    assert read_f32(bench.inputs(8, 2)) == pytest.approx(held_n, abs=10)


@pytest.mark.parametrize("mode", ["continuous"], indirect=True)
def test_the_watchdog_counts_wall_time_and_is_fed_by_changes_only(bench: Served) -> None:
    bench.client.write_registers(0, [*f32(0.0), *f32(1.0), 0, 0, 5, 3], device_id=1)
    assert not bench.registers.watchdog.expired
    for beat in (6, 7, 8, 9):
        time.sleep(0.1)
        bench.client.write_registers(6, [beat], device_id=1)
        assert not bench.registers.watchdog.expired
    for _ in range(4):
        time.sleep(0.1)
        bench.client.write_registers(6, [9], device_id=1)
    assert bench.registers.watchdog.expired
    bench.machine.trip_watchdog()
    assert bench.inputs(3, 1) == [2]
    bench.client.write_registers(6, [10], device_id=1)
    assert not bench.registers.watchdog.expired
    bench.client.write_registers(4, [2], device_id=1)
    assert bench.inputs(3, 1) == [0]


@pytest.mark.parametrize("mode", ["continuous"], indirect=True)
def test_the_stage_moves_close_to_its_commanded_position(bench: Served) -> None:
    bench.client.write_registers(100, [*f32(1900.0), *f32(-10.0), 1, 2], device_id=1)
    assert bench.inputs(100, 1) == [1]  # for a second
    bench.client.write_registers(100, [*f32(40.0), *f32(-10.0), 1, 3], device_id=1)
    wait_until(lambda: bench.inputs(100, 1) == [0])
    answer = bench.inputs(100, 7)
    assert read_f32(answer[1:3]) == pytest.approx(40.0, abs=2)
    assert read_f32(answer[3:5]) == pytest.approx(-10.0, abs=2)


@pytest.mark.parametrize("mode", ["continuous"], indirect=True)
def test_the_beam_is_shifted_next_to_the_stage_with_errors_of_its_own(bench: Served) -> None:
    assert bench.inputs(400, 1) == [0]
    bench.client.write_registers(400, [*f32(20.0), *f32(-10.0), 1, 3], device_id=1)
    wait_until(lambda: bench.inputs(400, 1) == [0] and abs(read_f32(bench.inputs(401, 2)) - 20.0) < 0.1)
    assert bench.inputs(100, 1) == [0]
    assert abs(read_f32(bench.inputs(101, 2))) < 0.5  # the stage has not moved
    assert read_f32(bench.inputs(403, 2)) == pytest.approx(-10.0, abs=0.1)
    newest = bench.machine.window(1e9, 1e9)
    x_um, y_um = newest.motion.shift_px[-1] * 1.25
    assert x_um == pytest.approx(1.03 * 20.0 + 0.96 * 0.035 * -10.0, abs=0.1)
    assert y_um == pytest.approx(0.96 * -10.0, abs=0.1)
    assert bench.client.write_registers(400, [*f32(60.0), *f32(0.0), 1, 4], device_id=1).exception_code == 3


@pytest.mark.parametrize("mode", ["continuous"], indirect=True)
def test_a_strain_gage_reports_the_strain_and_a_fault_its_reason(bench: Served) -> None:
    assert bench.inputs(300, 1) == [0]
    assert abs(read_f32(bench.inputs(301, 2))) < 15e-6
    bench.client.write_registers(0, [*f32(1000.0), *f32(100.0), 1, 1, 0, 0], device_id=1)
    wait_until(lambda: bench.inputs(3, 1) == [0])
    printed = read_f32(bench.inputs(301, 2))
    assert printed == pytest.approx(1.005 * 1000.0 / 711_000 + 4e-6, abs=16e-6)
    bench.machine.trip_watchdog()
    assert bench.inputs(3, 1) == [2]
    assert bench.inputs(300, 1) == [2]


@pytest.mark.parametrize("mode", ["continuous"], indirect=True)
@pytest.mark.parametrize(
    ("address", "values", "exception"),
    [
        (0, [*f32(5000.0), *f32(10.0), 1, 0, 0, 0], 3),  # beyond its own force limit
        (0, [*f32(float("nan")), *f32(10.0), 1, 0, 0, 0], 3),
        (0, [*f32(100.0), *f32(0.0), 1, 0, 0, 0], 3),
        (4, [9], 3),
        (100, [*f32(1e6), *f32(0.0), 1, 0], 3),
        (104, [7], 3),
        (200, [2], 3),
        (200, [1], 6),  # it scans continuously
        (7, [0, 0], 2),
        (8, [0], 2),
        (106, [0], 2),
        (201, [0], 2),
    ],
)
def test_what_makes_no_sense_is_refused(bench: Served, address: int, values: list[int], exception: int) -> None:
    answer = bench.client.write_registers(address, values, device_id=1)
    assert answer.isError()
    assert answer.exception_code == exception
    assert bench.inputs(3, 1) == [0]
    assert bench.inputs(100, 1) == [0]


@pytest.mark.parametrize("mode", ["continuous"], indirect=True)
@pytest.mark.parametrize(("address", "count"), [(0, 17), (16, 1), (99, 1), (100, 8), (107, 1), (200, 3), (202, 1), (60000, 1)])
def test_reading_beyond_a_block_is_exception_2(bench: Served, address: int, count: int) -> None:
    answer = bench.client.read_input_registers(address, count=count, device_id=1)
    assert answer.isError()
    assert answer.exception_code == 2


@pytest.mark.parametrize("mode", ["triggered"], indirect=True)
def test_a_trigger_scans_one_frame_and_is_refused_meanwhile(bench: Served, tmp_path: Path) -> None:
    assert bench.inputs(200, 2) == [0, 0]
    assert not bench.client.write_register(200, 1, device_id=1).isError()
    assert bench.inputs(200, 1) == [1]
    again = bench.client.write_register(200, 1, device_id=1)
    assert again.isError()
    assert again.exception_code == 6
    wait_until(lambda: bench.inputs(200, 2) == [0, 1])
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["x200_0001.tif"]
    time.sleep(0.1)  # longer than a frame: nothing scans by itself
    assert bench.inputs(200, 2) == [0, 1]
    assert not bench.client.write_register(200, 1, device_id=1).isError()
    wait_until(lambda: bench.inputs(200, 2) == [0, 2])


def spoken(port: int, *requests: bytes, unit: int = 1) -> list[bytes]:
    """Answers to requests written byte by byte as the protocol's specification has them, without any library."""
    answers = []
    with socket.create_connection(("127.0.0.1", port), timeout=20) as link:
        for number, request in enumerate(requests):
            link.sendall(struct.pack(">HHHB", number, 0, len(request) + 1, unit) + request)
            head = struct.unpack(">HHHB", link.recv(7, socket.MSG_WAITALL))
            assert (head[0], head[1], head[3]) == (number, 0, unit)
            answers.append(link.recv(head[2] - 1, socket.MSG_WAITALL))
    return answers


@pytest.mark.parametrize("mode", ["continuous"], indirect=True)
def test_bytes_on_the_wire_are_those_of_the_specification(bench: Served) -> None:
    words = struct.pack(">ff4H", 150.0, 50.0, 1, 77, 9, 0)
    identity, beyond, single, block, back, coils = spoken(
        bench.port,
        struct.pack(">BHH", 4, 0, 4),
        struct.pack(">BHH", 4, 16, 1),
        struct.pack(">BHH", 6, 6, 12),
        struct.pack(">BHHB", 16, 0, 8, 16) + words,
        struct.pack(">BHH", 3, 0, 8),
        struct.pack(">BHH", 1, 0, 1),
    )
    assert identity == bytes([4, 8]) + struct.pack(">4H", 0x5E31, 1, 3, 0)
    assert beyond == bytes([0x84, 2])
    assert single == struct.pack(">BHH", 6, 6, 12)
    assert block == struct.pack(">BHH", 16, 0, 8)
    assert back == bytes([3, 16]) + words
    assert coils == bytes([0x81, 1])
    target = spoken(bench.port, struct.pack(">BHH", 4, 8, 2))[0]
    assert struct.unpack(">f", target[2:]) == (150.0,)
