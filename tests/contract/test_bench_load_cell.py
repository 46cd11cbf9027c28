"""Resolution of the load cell and displacement control, as every line of the bench serves them."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import select
import statistics
from collections.abc import Iterator
from pathlib import Path

import pytest
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from semlive_simulators.load_frame.registers import f32, read_f32
from semlive_simulators.load_frame.serial_lines import ascii_line, rtu_line
from semlive_simulators.load_frame.server import UNIT
from semlive_simulators.scenario import BadScenario, load_scenario
from semlive_simulators.specimen.machine import LoadTrain

from ..waiting import wait_until
from .running_bench import running_bench

RATE = 100.0
COARSE = "extends: paper_x200\nscan: {width_px: 64, height_px: 55, frame_time_s: 6.0}\nload_frame: {cell_resolution_n: 2.5}\n"
Client = ModbusTcpClient | ModbusSerialClient


@pytest.fixture(params=["tcp", "rtu", "serial"])
def line(request: pytest.FixtureRequest) -> str:
    return request.param


@contextlib.contextmanager
def served(tmp_path: Path) -> Iterator[tuple[ModbusTcpClient, ModbusSerialClient, int, LoadTrain]]:
    (tmp_path / "coarse.yaml").write_text(COARSE)
    scenario = load_scenario(str(tmp_path / "coarse.yaml"))
    with (
        running_bench(scenario, RATE, tmp_path) as bench,
        rtu_line(bench.port, UNIT, bench.registers.line_faults) as rtu,
        ascii_line(bench.machine, bench.clock.now_ns, bench.registers.line_faults) as (letters, _),
        contextlib.closing(ModbusTcpClient("127.0.0.1", port=bench.port, timeout=20, retries=0)) as tcp,
        contextlib.closing(ModbusSerialClient(rtu, baudrate=19_200, timeout=20, retries=0)) as serial,
    ):
        assert tcp.connect()
        assert serial.connect()
        handle = os.open(letters, os.O_RDWR | os.O_NOCTTY)
        yield tcp, serial, handle, bench.machine
        os.close(handle)


def force_in_letters(handle: int) -> float:
    os.write(handle, b"n")
    answer = b""
    while not answer.endswith(b" N\r\n"):
        assert select.select([handle], [], [], 20.0)[0]
        answer += os.read(handle, 4096)
    return float(answer.split()[2])


def force_in_registers(client: Client) -> float:
    return read_f32(list(client.read_input_registers(4, count=2, device_id=UNIT).registers))


def test_every_line_reports_multiples_of_the_load_cell_resolution(tmp_path: Path, line: str) -> None:
    with served(tmp_path) as (tcp, serial, handle, machine):
        tcp.write_registers(0, [*f32(1201.0), *f32(100.0), 1, 1, 0, 0], device_id=UNIT)
        wait_until(lambda: tcp.read_input_registers(3, count=1, device_id=UNIT).registers == [0])
        ask = {
            "tcp": lambda: force_in_registers(tcp),
            "rtu": lambda: force_in_registers(serial),
            "serial": lambda: force_in_letters(handle),
        }
        printed = [ask[line]() for _ in range(15)]
        true_n = machine.window(1e9, 1e9).force_mean_n
        first = printed[-1]
        wait_until(lambda: ask[line]() != first)  # noise of 1 N leads from one step to the next
    assert {force_n % 2.5 for force_n in printed} == {0.0}
    assert statistics.fmean(printed) == pytest.approx(true_n, abs=4 * (1.0 + 2.5**2 / 12) ** 0.5 / 15**0.5 + 3.0)  # 3 N relax meanwhile


def test_a_reading_is_the_nearest_step_and_none_by_default() -> None:
    paper = load_scenario("paper_x200")
    assert paper.load_frame.cell_resolution_n == 0.0
    finest = LoadTrain(paper, 0)
    coarse = LoadTrain(dataclasses.replace(paper, load_frame=dataclasses.replace(paper.load_frame, cell_resolution_n=2.5)), 0)
    for machine in (finest, coarse):
        machine.ramp_to(777.0, 100.0)
    for second in range(1, 12):
        exact, stepped = (machine.read(second * 1_000_000_000).force_n for machine in (finest, coarse))
        assert exact % 2.5 != 0.0
        assert stepped == 2.5 * round(exact / 2.5)


def test_a_negative_resolution_is_refused_with_one_error_line(tmp_path: Path) -> None:
    (tmp_path / "coarse.yaml").write_text(COARSE.replace("2.5", "-1"))
    with pytest.raises(BadScenario, match=r"load_frame: .*cell_resolution_n must be at least 0"):
        load_scenario(str(tmp_path / "coarse.yaml"))


@pytest.mark.parametrize("wired", ["tcp", "rtu"])
def test_a_crosshead_is_driven_over_registers(tmp_path: Path, wired: str) -> None:
    with served(tmp_path) as (tcp, serial, _, machine):
        client: Client = tcp if wired == "tcp" else serial

        def inputs(address: int, count: int) -> list[int]:
            return list(client.read_input_registers(address, count=count, device_id=UNIT).registers)

        block = [*f32(0.15), *f32(0.01), 1, 42]
        assert not client.write_registers(300, block, device_id=UNIT).isError()
        assert client.read_holding_registers(300, count=6, device_id=UNIT).registers == block
        wait_until(lambda: inputs(3, 1) == [0])
        assert read_f32(inputs(6, 2)) == pytest.approx(0.15, abs=1e-3)
        assert force_in_registers(client) == pytest.approx(0.15 / (1 / specimen_stiffness_n_mm() + 1 / 8000), rel=0.02)
        client.write_registers(300, [*f32(-1.0), *f32(0.001), 1, 43], device_id=UNIT)
        assert inputs(3, 1) == [1]
        client.write_registers(304, [2], device_id=UNIT)
        assert inputs(3, 1) == [0]
        for bad in ([*f32(25.0), *f32(0.01), 1, 44], [*f32(0.1), *f32(0.0), 1, 44], [*f32(float("nan")), *f32(0.01), 1, 44]):
            assert client.write_registers(300, bad, device_id=UNIT).exception_code == 3
        assert client.write_registers(304, [3], device_id=UNIT).exception_code == 3
        assert client.write_registers(306, [0], device_id=UNIT).exception_code == 2
        assert machine.jogging_mm_s == 0.0


def specimen_stiffness_n_mm() -> float:
    return load_scenario("paper_x200").specimen.stiffness_n_mm
