"""Devices as their public documents describe them, driven by the maps that come with semlive."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from semlive.data.checks import Verdict
from semlive.data.loading import ControlMode, MotionState, StopOnLinkLoss
from semlive.errors import BadConfig, LinkError, LinkRefused
from semlive.ports import LoadFrame, OrderCheck
from semlive_drivers.composite_config import open_load_frame
from semlive_drivers.maps import UNCONFIRMED_NOTE, bundled_maps, map_content
from semlive_drivers.modbus.check import check_modbus
from semlive_drivers.modbus.device_map import load_map
from semlive_drivers.modbus.load_frame import open_load_frame as open_one

from ...clocks import MonotonicClock
from ...waiting import wait_until
from .emulated import Device, Spring, laumas_tlb, leadshine, oriental_az, over_rtu, over_tcp

CLOCK = MonotonicClock()
APPROACH = {"stiffness_n_mm": 1200.0, "speed_max_mm_s": 0.5, "speed_min_mm_s": 0.01, "arrived_n": 0.5, "ahead_s": 0.2}


@contextmanager
def tcp(*devices: Device) -> Iterator[list[int]]:
    with ExitStack() as stack:
        yield [stack.enter_context(over_tcp(device)) for device in devices]


@contextmanager
def pulled(drive_map: str, drive: Device, spring: Spring, **approach: float) -> Iterator[LoadFrame]:
    """A cell and a drive of two makes as one load frame."""
    with tcp(laumas_tlb(spring), drive) as (cell_port, drive_port):
        frame = open_load_frame(
            {
                "cell": {"map": "laumas_tlb", "port": cell_port, "timeout_s": 2.0},
                "drive": {"map": drive_map, "port": drive_port, "confirmed": True, "timeout_s": 2.0},
                "approach": {**APPROACH, **approach},
            },
            CLOCK,
        )
        yield frame
        frame.close()


@pytest.mark.parametrize("name", bundled_maps())
def test_every_map_reports_where_it_is_from_and_only_the_bench_is_confirmed(name: str) -> None:
    content = map_content(name)
    assert content.get("confirmed", False) == (name == "bench")
    assert name == "bench" or "confirm before motion" in content["source"]


def test_a_sign_in_a_status_bit_and_decimals_in_another_register() -> None:
    spring = Spring(at_mm=-0.0123, to_mm=-0.0123)
    cell = laumas_tlb(spring)
    with tcp(cell) as (port,):
        frame = open_one({"map": "laumas_tlb", "port": port}, CLOCK)
        assert frame.read().force_n == pytest.approx(-12.3)
        cell.words[13] = 0 << 8 | 13  # kg with three decimals
        assert frame.read().force_n == pytest.approx(-0.123 * 9.80665)
        for code, division in enumerate((100, 50, 20, 10, 5, 2, 1, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 5e-4, 2e-4, 1e-4)):
            cell.words[13] = 4 << 8 | code  # N; the register holds the displayed digits without the decimal point
            decimals = len(f"{division:.4f}".rstrip("0").partition(".")[2])
            assert frame.read().force_n == pytest.approx(-123 * 10**-decimals), f"division {division}"
        cell.words[13] = 9 << 8 | 13  # N m: no force
        with pytest.raises(LinkError, match="division is 9, and the register map does not state"):
            frame.read()
        cell.words[13] = 4 << 8 | 7
        cell.before_read = lambda: cell.words.update({6: 0x0001})
        with pytest.raises(LinkError, match="gives no reading: load cell error"):
            frame.read()
        with pytest.raises(LinkError, match="cannot be moved by semlive"):
            frame.ramp_to(1.0, 1.0)
        assert not cell.writes
        frame.close()


@pytest.mark.parametrize(("name", "made"), [("oriental_az", oriental_az), ("leadshine_rs", leadshine)])
def test_a_drive_without_load_control_reaches_a_load_and_returns(name: str, made: type) -> None:
    spring = Spring()
    with pulled(name, made(spring), spring) as frame:
        for target_n in (60.0, 20.0):
            frame.ramp_to(target_n, 100.0)
            assert frame.read().motion is MotionState.MOVING
            highest = []
            wait_until(lambda stored=highest: (stored.append(frame.read()), stored[-1].motion is MotionState.STOPPED)[1])
            assert frame.read().force_n == pytest.approx(target_n, abs=1.0)
            assert max(sample.force_n for sample in highest) < 61.5
        assert frame.identity.stop_on_link_loss is StopOnLinkLoss.NONE


def test_a_drive_without_commands_stops_after_the_ordered_travel() -> None:
    spring = Spring()
    with pulled("oriental_az", oriental_az(spring), spring) as frame:
        frame.ramp_to(400.0, 100.0)
        time.sleep(0.1)
        assert spring.look()[0] == pytest.approx(0.0005)  # the first way of a ramp is short
        for _ in range(8):
            frame.read()
            time.sleep(0.03)
        remaining_mm = spring.look()[0]
        time.sleep(0.5)
        at_mm, _, moving = spring.look()
        assert not moving
        assert 0 < at_mm - remaining_mm < 100.0 / 1200.0 * 0.2 + 2e-3


def test_a_stop_ends_the_ramp() -> None:
    spring = Spring()
    with pulled("oriental_az", oriental_az(spring), spring) as frame:
        frame.ramp_to(400.0, 100.0)
        frame.read()
        frame.stop()
        at_mm = spring.look()[0]
        assert frame.read().motion is MotionState.STOPPED
        frame.read()
        assert spring.look()[0] == at_mm


def test_a_specimen_that_breaks_is_not_followed() -> None:
    spring = Spring(breaks_at_n=50.0)
    with pulled("oriental_az", oriental_az(spring), spring) as frame:
        frame.ramp_to(400.0, 200.0)
        with pytest.raises(LinkError, match=r"the load went from .* to 0.0 N on its way to 400 N; check sign and direction"):
            wait_until(lambda: frame.read().motion is MotionState.STOPPED)
        assert not spring.look()[2]
        assert frame.read().motion is MotionState.STOPPED


def test_a_way_without_an_end_has_one() -> None:
    spring = Spring(stiffness_n_mm=10.0)
    with pulled("oriental_az", oriental_az(spring), spring, travel_max_mm=0.1) as frame:
        frame.ramp_to(400.0, 500.0)
        with pytest.raises(LinkError, match=r"of travel brought the load to .* only, not to 400 N"):
            wait_until(lambda: frame.read().motion is MotionState.STOPPED)
        assert 0.08 < spring.look()[0] < 0.13


def test_a_speed_that_the_drive_cannot_represent_is_refused() -> None:
    spring = Spring()
    with pulled("leadshine_rs", leadshine(spring), spring, speed_min_mm_s=0.0) as frame:
        with pytest.raises(
            LinkError, match=r"mm/s is less than one count of speed \(holding register 25091\); give approach: speed_min_mm_s"
        ):
            frame.ramp_to(400.0, 1.0)
        assert spring.look()[0] == 0.0


def test_an_unconfirmed_map_moves_nothing() -> None:
    spring = Spring()
    with tcp(laumas_tlb(spring), oriental_az(spring)) as (cell, drive):
        parts = {"cell": {"map": "laumas_tlb", "port": cell}, "drive": {"map": "oriental_az", "port": drive}}
        frame = open_load_frame({**parts, "approach": APPROACH}, CLOCK)
        with pytest.raises(LinkError, match=f"is {UNCONFIRMED_NOTE}; check it with `semlive frame check`"):
            frame.ramp_to(10.0, 10.0)
        frame.stop()
        frame.close()
        with pytest.raises(BadConfig, match="has no load control; give approach"):
            open_load_frame(parts, CLOCK)
        with pytest.raises(BadConfig, match="no part measures the load; name one that does"):
            open_load_frame({"drive": parts["drive"], "approach": APPROACH}, CLOCK)


def test_two_devices_on_one_serial_line() -> None:
    spring = Spring()
    with over_rtu({1: laumas_tlb(spring), 2: oriental_az(spring)}) as path:
        serial = {"port": path, "baud": 115_200, "parity": "none", "slowest_s": 0.1}
        frame = open_load_frame(
            {
                "cell": {"map": "laumas_tlb", "serial": serial, "unit": 1},
                "drive": {"map": "oriental_az", "serial": serial, "unit": 2, "confirmed": True},
                "approach": APPROACH,
            },
            CLOCK,
        )
        frame.ramp_to(30.0, 200.0)
        wait_until(lambda: frame.read().motion is MotionState.STOPPED)
        assert frame.read().force_n == pytest.approx(30.0, abs=1.0)
        frame.close()


def test_a_watchdog_of_its_own_is_armed_and_fed_by_changing_numbers() -> None:
    spring = Spring()
    wago = Device(dict.fromkeys(range(0x1000, 0x100A), 0))
    with tcp(laumas_tlb(spring), wago) as (cell, coupler):
        watchdog = {"map": "wago_watchdog", "port": coupler, "watchdog_s": 1.5}
        frame = open_load_frame({"cell": {"map": "laumas_tlb", "port": cell}, "watchdog": watchdog}, CLOCK)
        assert wago.words[0x1000] == 15
        fed = []
        for _ in range(3):
            frame.read()
            fed.append(wago.words[0x1003])
        assert len(set(fed)) == 3
        wago.words[0x1006] = 2
        with pytest.raises(LinkError, match="its watchdog has expired; find out why"):
            frame.read()
        frame.close()


def test_a_strain_gage_from_a_file_or_another_device_is_reported_with_the_load(tmp_path: Path) -> None:
    spring = Spring(at_mm=0.01, to_mm=0.01)
    amplifier = Device({301: 0x3A03, 302: 0x126F})  # 5.0e-4
    path, mine = tmp_path / "daq.csv", tmp_path / "amplifier.yaml"
    path.write_text("t;eps\n0,0;123,5\n", encoding="utf-8")
    points = "points: {gage: {kind: input, address: 301, dtype: f32}}"
    mine.write_text(f"protocol: modbus\nname: amplifier\nsource: mine\n{points}\ntells: {{strain_gage: gage}}\n", encoding="utf-8")
    with tcp(laumas_tlb(spring), amplifier) as (cell_port, gage_port):
        cell = {"map": "laumas_tlb", "port": cell_port}
        gages = [
            {"protocol": "csv", "file": str(path), "decimal_comma": True, "gage": {"column": "eps", "unit": "ustrain"}},
            {"map": str(mine), "port": gage_port, "strain_gage": True},
        ]
        for gage, strain in zip(gages, (123.5e-6, 5.0e-4), strict=True):
            frame = open_load_frame({"cell": cell, "gage": gage}, CLOCK)
            sample = frame.read()
            assert sample.force_n == pytest.approx(10.0)
            assert sample.gage_strain == pytest.approx(strain, rel=1e-6)
            frame.close()


def test_a_look_reads_and_never_writes() -> None:
    spring = Spring(at_mm=-0.5, to_mm=-0.5)
    cell, drive = laumas_tlb(spring), oriental_az(spring)
    with tcp(cell, drive) as (cell_port, drive_port):
        found = check_modbus("laumas_tlb", {"port": cell_port})
        printed = {finding.what: finding for finding in found.findings}
        assert printed["gross"].observation.startswith("-500 ")
        assert printed["order of words"].verdict is Verdict.OK
        assert "gross: high word first makes sense" in printed["order of words"].observation
        assert found.passed
        assert not found.confirmed
        assert check_modbus("oriental_az", {"port": drive_port}).passed
    assert cell.requests
    assert not cell.writes + drive.writes


def test_identification_finds_a_wrong_word_order_and_a_missing_register() -> None:
    cell = laumas_tlb(Spring(at_mm=0.05, to_mm=0.05))
    del cell.words[3]
    with tcp(cell) as (port,):
        found = check_modbus("laumas_tlb", {"port": port, "registers": {"gross": {"words": "low_first"}}})
    printed = {finding.what: finding for finding in found.findings}
    assert printed["order of words"].verdict is Verdict.FAILED
    assert "the description states low word first: correct it" in printed["order of words"].advice
    assert "no such register (exception 2)" in printed["serial_number"].observation
    assert not found.passed


def test_nobody_answers_on_a_line_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(LinkRefused, match="cannot be opened"):
        open_one({"serial": {"port": str(tmp_path / "ttyUSB7")}}, CLOCK)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("", ""),
        ("tells: {force: farce}", "tells names a point 'farce' that is not among points"),
        ("every_turn: [[extension]]", "every_turn must contain force, which every reading needs"),
        ("orders: {stop: [{set: {command: now}}]}", "orders.stop writes 'now'; an order can write numbers and force_n"),
        ("tells: {force: force, force_unit: stone}", "unit 'stone' is not known; it may be 1, N, kN"),
        ("tals: {}", "tals: Extra inputs are not permitted"),
        ("orders: {stop: [{set: {force: 0}}]}", "orders.stop writes force, which is read-only"),
        ("other_stops: [{says: power off, writes: [{set: {enable: 0}}]}]", "other_stops names a point 'enable' that is not among points"),
        ("other_stops: [{says: power off, writes: [{set: {command: now}}]}]", "writes 'now'; an order can write numbers and force_n"),
        ("changes_by_itself: [target]", "changes_by_itself names a point 'target'"),
        ("orders: {hover: []}", "orders.hover.*Input should be 'ramp', 'pull', 'push', 'stop'"),
    ],
)
def test_what_is_wrong_in_a_map_is_reported(tmp_path: Path, change: str, sentence: str) -> None:
    key = change.split(":")[0]
    text = ["protocol: modbus", "name: mine", "source: mine", "points: {force: {kind: input, address: 0, dtype: f32}, "]
    text[3] += "extension: {kind: input, address: 2, dtype: f32}, command: {kind: holding, address: 4}}"
    usual = {"every_turn": "every_turn: [[force, extension]]", "tells": "tells: {force: force, extension: extension}"}
    text += [line for name, line in usual.items() if name != key] + [change]
    path = tmp_path / "mine.yaml"
    path.write_text("\n".join(text), encoding="utf-8")
    if not change:
        assert load_map(str(path)).tells.force == "force"
        return
    with pytest.raises(BadConfig, match=sentence):
        load_map(str(path))


def test_a_map_that_does_not_exist() -> None:
    with pytest.raises(BadConfig, match=r"no device description is called 'laumas'; there are bench, .*generic, .*laumas_tlb"):
        load_map("laumas")
    with pytest.raises(BadConfig, match=r"none\.yaml: cannot be read"):
        load_map("none.yaml")


def test_an_order_that_a_drive_or_a_frame_cannot_hold_is_named_before_anything_is_sent() -> None:
    spring = Spring()
    drive = leadshine(spring)
    with pulled("leadshine_rs", drive, spring, speed_min_mm_s=0.0) as frame:
        assert isinstance(frame, OrderCheck)
        assert frame.order_problem(400.0, 120.0) is None
        assert "the drive takes 0.01 mm/s" in str(frame.order_problem(400.0, 20.0))
        assert "faster than speed_max_mm_s 0.5; order at most 600 N/s" in str(frame.order_problem(400.0, 700.0))
        assert not drive.writes
    plain = Device(dict.fromkeys(range(20), 0))
    with tcp(plain) as (port,):
        points = {"target": {"dtype": "i16", "scale": 0.1, "address": 10}, "rate": {"dtype": "u16", "scale": 0.1, "address": 12}}
        frame = open_one({"map": "generic", "port": port, "registers": points, "confirmed": True}, CLOCK)
        assert isinstance(frame, OrderCheck)
        assert frame.order_problem(300.0, 30.0) is None
        assert "is less than one count of rate (holding register 12)" in str(frame.order_problem(300.0, 0.04))
        assert "3500 does not fit into register 10" in str(frame.order_problem(3500.0, 30.0))
        with pytest.raises(LinkError, match="less than one count of rate"):
            frame.ramp_to(300.0, 0.04)
        assert not plain.writes
        plain.words.update({11: 777, 13: 5000})
        frame.ramp_to(300.0, 30.0)
        frame.stop()
        assert [plain.words[address] for address in (10, 11, 12, 13, 4)] == [3000, 777, 300, 5000, 2]
        frame.close()


def test_a_frame_reports_how_it_is_moved_and_how_fine_its_readings_are() -> None:
    spring = Spring()
    with pulled("oriental_az", oriental_az(spring), spring) as frame:
        reported = frame.identity
        assert reported.control is ControlMode.DISPLACEMENT
        assert reported.force_resolution_n == pytest.approx(0.1)
        assert reported.extension_resolution_mm == pytest.approx(1e-4)
        assert reported.measures_extension
        assert reported.stiffness_n_mm == APPROACH["stiffness_n_mm"]
    cell = laumas_tlb(spring)
    cell.words[13] = 0 << 8 | 13  # kg with three decimals
    with tcp(cell) as (port,):
        frame = open_one({"map": "laumas_tlb", "port": port}, CLOCK)
        reported = frame.identity
        assert reported.control is ControlMode.MANUAL
        assert reported.force_resolution_n == pytest.approx(9.80665e-3)
        assert not reported.measures_extension
        assert reported.stiffness_n_mm is None
        frame.close()


def test_a_saturated_cell_is_no_reading() -> None:
    spring = Spring()
    cell = laumas_tlb(spring)
    with tcp(cell) as (port,):
        limits = {"gross": {"range": [-500, 500]}}
        frame = open_one({"map": "laumas_tlb", "port": port, "registers": limits}, CLOCK)
        spring.move(0.6, 1e6)
        with pytest.raises(LinkError, match=r"gross \(register 7\) is at the end of its range \(600\): the sensor is saturated"):
            frame.read()
        cell.before_read = lambda: cell.set32(7, 0xFFFFFFFF)
        with pytest.raises(LinkError, match=r"is at the end of its range \(4294967295\)"):
            frame.read()
        frame.close()
        printed = {finding.what: finding for finding in check_modbus("laumas_tlb", {"port": port}).findings}
        assert printed["gross"].verdict is Verdict.FAILED
    with pytest.raises(BadConfig, match=r"range is \[5, 1\], which is no range"):
        open_one({"map": "laumas_tlb", "registers": {"gross": {"range": [5, 1]}}}, CLOCK)


def test_a_drive_can_be_made_free_and_a_watchdog_can_be_withheld() -> None:
    spring = Spring()
    drive, wago = oriental_az(spring), Device(dict.fromkeys(range(0x1000, 0x100A), 0))
    with tcp(laumas_tlb(spring), drive, wago) as (cell, drive_port, coupler):
        parts = {
            "cell": {"map": "laumas_tlb", "port": cell},
            "drive": {"map": "oriental_az", "port": drive_port, "confirmed": True},
            "watchdog": {"map": "wago_watchdog", "port": coupler, "watchdog_s": 1.5},
        }
        frame = open_load_frame({**parts, "approach": APPROACH}, CLOCK)
        assert frame.stop_methods == ("motor current off (FREE)", "watchdog withheld")
        frame.stop_by(0)
        assert drive.get32(0x7C) == 0x40
        frame.stop()
        assert drive.get32(0x7C) == 0
        frame.read()
        frame.stop_by(1)
        fed = wago.words[0x1003]
        frame.read()
        assert wago.words[0x1003] == fed
        frame.close()
