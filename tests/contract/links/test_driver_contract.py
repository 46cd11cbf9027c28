"""One contract for every load frame that comes with semlive, each over a link to a machine of its own."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from semlive.ports import LoadFrame
from semlive_drivers import null
from semlive_drivers.composite_config import open_load_frame as open_assembled
from semlive_drivers.conformance import CHECKS, Check
from semlive_drivers.modbus.load_frame import open_load_frame as open_modbus
from semlive_drivers.operator.console import Console
from semlive_drivers.operator.load_frame import open_load_frame as open_operator
from semlive_drivers.text.load_frame import open_load_frame as open_text
from semlive_simulators.bench_clock import BenchClock
from semlive_simulators.load_frame.line_faults import Line, LineFault
from semlive_simulators.load_frame.serial_lines import ascii_line, rtu_line
from semlive_simulators.load_frame.server import UNIT, BenchRegisters, ModbusThread
from semlive_simulators.microscope.sem import Sem
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.machine import LoadTrain

from ...clocks import MonotonicClock
from .emulated import Device, Spring, laumas_tlb, leadshine, oriental_az, over_rtu, over_tcp
from .text_server import over_text

CLOCK = MonotonicClock()
APPROACH = {"stiffness_n_mm": 1200.0, "speed_max_mm_s": 0.5, "speed_min_mm_s": 0.01, "arrived_n": 0.5, "ahead_s": 0.2}


class SomeRig:
    """A rig of functions; `disconnect_link` cuts the link."""

    def __init__(
        self,
        open_frame: Callable[[], LoadFrame],
        moves: Callable[[], bool] = lambda: False,
        disconnect_link: Callable[[bool], None] | None = None,
        reachable_n: float = 0.0,
        tolerance_n: float = 1.0,
    ) -> None:
        self._open, self._moves, self._disconnect_link = open_frame, moves, disconnect_link
        self.reachable_n, self.tolerance_n, self.can_disconnect = reachable_n, tolerance_n, disconnect_link is not None

    def open(self) -> LoadFrame:
        return self._open()

    def moves(self) -> bool:
        return self._moves()

    def disconnect(self) -> None:
        if self._disconnect_link is not None:
            self._disconnect_link(True)

    def reconnect(self) -> None:
        if self._disconnect_link is not None:
            self._disconnect_link(False)


def bench(stack: ExitStack, line: Line) -> SomeRig:
    """The simulated bench, over one of its lines."""
    scenario, clock = load_scenario("paper_x200"), BenchClock(1.0 if line is Line.SERIAL else 2.0, lambda _: None)
    machine = LoadTrain(scenario, clock.start_ns)
    machine.read(clock.start_ns)
    sem = Sem(scenario, clock, machine, Path(), True, lambda _: None, lambda _: None)
    registers = BenchRegisters(scenario, clock, machine, sem)
    server = ModbusThread(registers, 0)
    port = server.start()
    stack.callback(server.stop)
    clock.begin()
    troubles = registers.line_faults

    def disconnect_link(yes: bool) -> None:
        troubles.order(LineFault.SILENT, [line], 1, 60.0) if yes else troubles.clear()

    def moves() -> bool:
        reading = machine.read(clock.now_ns())
        return reading.load_frame_moving

    settings: dict[str, object] = {"timeout_s": 1.0, "frozen_after_s": 5.0}
    if line is Line.SERIAL:
        path, _ = stack.enter_context(ascii_line(machine, clock.now_ns, troubles))
        approach = {"stiffness_n_mm": 8000.0, "speed_max_mm_s": 0.05, "speed_min_mm_s": 0.0084, "arrived_n": 12.0, "ahead_s": 0.6}
        text = {"map": "mark10_esm", "serial": {"port": path, "slowest_s": 0.2}, "confirmed": True, "approach": approach}
        return SomeRig(lambda: open_text({**text, "timeout_s": 1.0}, CLOCK), moves, disconnect_link, 150.0, 60.0)
    if line is Line.RTU:
        settings["serial"] = {"port": stack.enter_context(rtu_line(port, UNIT, troubles)), "slowest_s": 0.2}
    else:
        settings["port"] = port
    return SomeRig(lambda: open_modbus(settings, CLOCK), moves, disconnect_link, 100.0, 30.0)


class Silence:
    """A device whose link can be cut."""

    def __init__(self, *devices: Device) -> None:
        self._devices = devices

    def __call__(self, yes: bool) -> None:
        for device in self._devices:
            device.silent = yes


def from_several(stack: ExitStack, name: str, make: Callable[[Spring], Device], rtu: bool) -> SomeRig:
    """A cell and a drive of two makes, over TCP or on one serial line."""
    spring = Spring()
    cell, drive = laumas_tlb(spring), make(spring)
    parts: dict[str, dict[str, object]] = {
        "cell": {"map": "laumas_tlb", "timeout_s": 1.0},
        "drive": {"map": name, "confirmed": True, "timeout_s": 1.0},
    }
    if rtu:
        line = {"port": stack.enter_context(over_rtu({1: cell, 2: drive})), "baud": 38_400, "parity": "none", "slowest_s": 0.2}
        parts["cell"] |= {"serial": line, "unit": 1}
        parts["drive"] |= {"serial": line, "unit": 2}
    else:
        parts["cell"] |= {"port": stack.enter_context(over_tcp(cell))}
        parts["drive"] |= {"port": stack.enter_context(over_tcp(drive))}
    settings = {**parts, "approach": APPROACH}
    return SomeRig(lambda: open_assembled(settings, CLOCK), lambda: spring.look()[2], Silence(cell, drive), 40.0, 1.5)


def cell_alone(stack: ExitStack) -> SomeRig:
    """A load cell over Modbus, and nothing that moves."""
    cell = laumas_tlb(Spring())
    port = stack.enter_context(over_tcp(cell))
    return SomeRig(lambda: open_modbus({"map": "laumas_tlb", "port": port}, CLOCK), disconnect_link=Silence(cell))


def amplifier(stack: ExitStack) -> SomeRig:
    """An amplifier with a text protocol."""
    silent = [False]
    reported = {"!001:STN?": "+1.0\r", "!001:SYS?": "+0.5\r", "!001:STAT?": "+0.0\r"}
    path = stack.enter_context(over_text(lambda line: "" if silent[0] else reported[line]))
    settings = {"map": "mantracourt_dsc", "serial": {"port": path, "slowest_s": 0.2}}
    return SomeRig(lambda: open_text(settings, CLOCK), disconnect_link=lambda yes: silent.__setitem__(0, yes))


def by_hand(stack: ExitStack) -> SomeRig:
    """A hand that types the load after a moment."""
    typed: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    stack.callback(typed.put, None)
    last_command_s = [0.0]

    def shown(line: str) -> None:
        if line.startswith("in "):
            last_command_s[0] = time.monotonic()
            typed.put("49.5")
        elif line.startswith("STOP"):
            last_command_s[0] = 0.0

    def lines() -> Iterator[str]:
        for line in iter(typed.get, None):
            time.sleep(0.5)
            yield line

    console = Console(lines, shown)
    return SomeRig(lambda: open_operator({}, CLOCK, console=console), reachable_n=50.0, tolerance_n=5.0)


def from_file(stack: ExitStack, path: Path) -> SomeRig:
    """A file that another program writes."""
    del stack
    path.write_text("load\n1.5\n", encoding="utf-8")
    cell = {"protocol": "csv", "file": str(path), "force": {"column": 1}}
    hidden = path.with_suffix(".away")

    def gone(yes: bool) -> None:
        if yes:
            path.rename(hidden)
        elif hidden.exists():
            hidden.rename(path)

    return SomeRig(lambda: open_assembled({"cell": cell}, CLOCK), disconnect_link=gone)


RIGS: dict[str, Callable[[ExitStack, Path], SomeRig]] = {
    "modbus over TCP": lambda stack, _: bench(stack, Line.TCP),
    "modbus over RTU": lambda stack, _: bench(stack, Line.RTU),
    "text": lambda stack, _: bench(stack, Line.SERIAL),
    "cell and drive over TCP": lambda stack, _: from_several(stack, "oriental_az", oriental_az, False),
    "cell and drive on one line": lambda stack, _: from_several(stack, "leadshine_rs", leadshine, True),
    "cell alone": lambda stack, _: cell_alone(stack),
    "amplifier": lambda stack, _: amplifier(stack),
    "operator": lambda stack, _: by_hand(stack),
    "file": lambda stack, folder: from_file(stack, folder / "load.csv"),
}


@pytest.fixture
def rig(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[SomeRig]:
    with ExitStack() as stack:
        yield RIGS[request.param](stack, tmp_path)


@pytest.mark.parametrize("check", CHECKS.values(), ids=CHECKS)
@pytest.mark.parametrize("rig", RIGS, indirect=True)
def test_the_contract(rig: SomeRig, check: Check) -> None:
    check(rig)


@pytest.mark.parametrize("name", ["check_port", "check_fresh_readings", "check_open_is_passive", "check_stop"])
def test_no_load_frame_keeps_the_contract_as_far_as_it_has_one(name: str) -> None:
    CHECKS[name](SomeRig(lambda: null.open_load_frame({}, CLOCK)))


class Runaway:
    """A driver that reports stopped and moves on."""

    def __init__(self) -> None:
        self._inner = null.open_load_frame({}, CLOCK)
        self.identity, self.read, self.stop, self.close = self._inner.identity, self._inner.read, lambda: None, self._inner.close

    def ramp_to(self, force_n: float, rate_n_s: float) -> None:
        """Go and never stop."""


def test_a_driver_that_does_not_stop_breaks_the_contract() -> None:
    with pytest.raises(AssertionError, match="the machine moves after a stop"):
        CHECKS["check_stop"](SomeRig(Runaway, lambda: True, reachable_n=10.0))
    with pytest.raises(AssertionError, match="readings must report moving during a ramp"):
        CHECKS["check_ramp"](SomeRig(Runaway, lambda: True, reachable_n=10.0))
