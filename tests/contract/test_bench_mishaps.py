"""Mishaps of the machine on request, ordered and seen over Modbus."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient

from semlive_simulators.load_frame.fault_schedule import MachineFault
from semlive_simulators.load_frame.registers import f32, read_f32
from semlive_simulators.load_frame.server import UNIT
from semlive_simulators.scenario import load_scenario
from semlive_simulators.simulate import main
from semlive_simulators.specimen.machine import LoadTrain

from ..waiting import wait_until
from .running_bench import running_bench

RATE = 100.0
ORDERS = {mishap: 101 + place for place, mishap in enumerate(MachineFault)}


@dataclass
class Served:
    """A bench behind a client; reading advances it."""

    client: ModbusTcpClient
    machine: LoadTrain

    def inputs(self, address: int, count: int) -> list[int]:
        answer = self.client.read_input_registers(address, count=count, device_id=UNIT)
        assert not answer.isError(), answer
        return list(answer.registers)

    def value(self, address: int) -> float:
        return read_f32(self.inputs(address, 2))

    def order(self, what: MachineFault, count: int = 0, hundredths: int = 0) -> None:
        assert not self.client.write_registers(900, [ORDERS[what], 0, count, hundredths], device_id=UNIT).isError()

    def go(self, force_n: float, rate_n_s: float = 100.0) -> None:
        block = [*f32(force_n), *f32(rate_n_s), 1, 1, 0, 0]
        assert not self.client.write_registers(0, block, device_id=UNIT).isError()

    def load(self, force_n: float) -> None:
        self.go(force_n)
        wait_until(lambda: self.inputs(3, 1) == [0])


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Served]:
    paper = load_scenario("paper_x200")
    frame = dataclasses.replace(paper.load_frame, extension_max_mm=0.6)
    scenario = dataclasses.replace(
        paper, load_frame=frame, scan=dataclasses.replace(paper.scan, width_px=64, height_px=55, frame_time_s=6.0)
    )
    with running_bench(scenario, RATE, tmp_path) as parts:
        client = ModbusTcpClient("127.0.0.1", port=parts.port, timeout=20, retries=0)
        assert client.connect()
        yield Served(client, parts.machine)
        client.close()


def test_the_numbers_are_those_of_the_page() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "reference" / "bench-registers.md").read_text(encoding="utf-8")
    for mishap, number in ORDERS.items():
        assert f"| {number} | `{mishap.value}` |" in page


def test_a_pressed_emergency_stop_is_released_by_time_or_by_command(bench: Served) -> None:
    bench.go(2000.0)
    bench.order(MachineFault.EMERGENCY_STOP, hundredths=60_000)
    wait_until(lambda: bench.inputs(300, 1) == [4])
    assert bench.inputs(3, 1) == [2]
    bench.client.write_register(4, 2, device_id=UNIT)
    wait_until(lambda: bench.inputs(300, 1) == [4])  # still pressed: a stop does not help
    assert bench.client.write_registers(0, [*f32(100.0), *f32(10.0), 1, 2, 0, 0], device_id=UNIT).exception_code == 4
    bench.client.write_registers(900, [0, 0, 0, 0], device_id=UNIT)
    bench.client.write_register(4, 2, device_id=UNIT)
    assert bench.inputs(3, 1) == [0]


def test_a_limit_switch_trips(bench: Served) -> None:
    bench.go(2000.0)
    wait_until(lambda: bench.value(4) > 100.0)
    bench.order(MachineFault.LIMIT_SWITCH)
    wait_until(lambda: bench.inputs(300, 1) == [3])
    bench.go(0.0, rate_n_s=1.0)  # a second at least, in which it is seen moving
    assert bench.inputs(3, 1) == [1]


def test_the_grips_slip_by_as_much_as_ordered(bench: Served) -> None:
    bench.load(1500.0)
    bench.client.write_register(4, 2, device_id=UNIT)
    before_n = bench.value(4)
    bench.order(MachineFault.GRIP_SLIP, count=40)
    stiffness_n_mm = 1 / (1 / load_scenario("paper_x200").specimen.stiffness_n_mm + 1 / 8000)
    wait_until(lambda: bench.value(4) < before_n - 100.0)
    assert before_n - bench.value(4) == pytest.approx(0.04 * stiffness_n_mm, abs=12)


def test_a_broken_specimen_lets_load_control_run_to_the_switch(bench: Served) -> None:
    bench.load(1000.0)
    bench.order(MachineFault.FRACTURE)
    wait_until(lambda: abs(bench.value(4)) < 10.0)
    bench.go(1000.0)
    wait_until(lambda: bench.inputs(300, 1) == [3])
    assert bench.value(6) == pytest.approx(0.6, abs=2e-3)


def test_a_stalled_stage_is_a_fault_until_its_next_order(bench: Served) -> None:
    bench.client.write_registers(100, [*f32(1900.0), *f32(0.0), 1, 3], device_id=UNIT)
    wait_until(lambda: bench.value(101) > 20.0)
    bench.order(MachineFault.STAGE_STALL)
    wait_until(lambda: bench.inputs(100, 1) == [2])
    stuck_um = bench.value(101)
    assert stuck_um < 1800.0
    time.sleep(0.05)
    assert bench.value(101) == pytest.approx(stuck_um, abs=0.5)
    assert bench.inputs(400, 1) == [0]
    bench.client.write_registers(100, [*f32(-1900.0), *f32(0.0), 1, 4], device_id=UNIT)
    assert bench.inputs(100, 1) == [1]  # for a second


def test_frozen_readings_and_their_counter_do_not_change_while_the_machine_moves(bench: Served) -> None:
    bench.order(MachineFault.FROZEN_READINGS, hundredths=60_000)
    wait_until(lambda: bench.inputs(10, 2) == bench.inputs(10, 2))
    first, gage = bench.inputs(4, 8), bench.inputs(301, 4)
    stage_count = bench.inputs(105, 2)
    bench.go(1000.0)
    wait_until(lambda: bench.inputs(3, 1) == [0])
    again = bench.inputs(4, 8)
    assert again[:4] + again[6:] == first[:4] + first[6:]  # the target is the machine's own
    assert bench.inputs(301, 4) == gage
    assert bench.inputs(105, 2) != stage_count
    assert bench.machine.window(1e9, 1e9).force_mean_n > 900.0
    bench.client.write_registers(900, [0, 0, 0, 0], device_id=UNIT)
    assert bench.value(4) > 900.0


def test_a_gage_with_a_broken_wire_reports_nothing(bench: Served) -> None:
    bench.order(MachineFault.GAGE_OFF, hundredths=60_000)
    wait_until(lambda: bench.value(301) != bench.value(301))
    assert abs(bench.value(4)) < 10.0
    bench.client.write_registers(900, [0, 0, 0, 0], device_id=UNIT)
    assert abs(bench.value(301)) < 15e-6


def test_a_frame_during_which_the_gage_reported_nothing_has_an_empty_field(tmp_path: Path) -> None:
    path = tmp_path / "off.yaml"
    path.write_text(
        "extends: paper_x200\nscan: {width_px: 64, height_px: 48, frame_time_s: 10.0}\n"
        "experiment: {protocol: {calibration_shifts_px: [[0, 0]], translation_shifts_px: [], loads_n: [300]}}\n"
        "faults: [{at_s: 35, lasts_s: 25, what: gage_off}]\n"
    )
    assert main(["--scenario", str(path), "--out", str(tmp_path / "out")]) == 0
    lines = (tmp_path / "out" / "frames.csv").read_text().splitlines()
    printed = [line.split(",")[-1] for line in lines[1:]]
    assert printed[:2] == ["", ""]
    assert float(printed[2]) == pytest.approx(1.005 * 300.0 / 711_000 + 4e-6, abs=1e-5)
