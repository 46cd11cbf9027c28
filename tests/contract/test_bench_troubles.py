"""Lines in trouble on request, seen by masters that others wrote: pymodbus over TCP and RTU, pyserial for letters."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import serial
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerType

from semlive.errors import LinkError
from semlive_drivers.modbus.load_frame import open_load_frame
from semlive_simulators.bench_clock import BenchClock
from semlive_simulators.load_frame.line_faults import Line, LineFault
from semlive_simulators.load_frame.serial_lines import ascii_line, rtu_line
from semlive_simulators.load_frame.server import UNIT, BenchRegisters
from semlive_simulators.microscope.sem import Sem
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.machine import LoadTrain

from ..clocks import WallClock
from ..waiting import wait_until
from .running_bench import running_bench

Client = ModbusTcpClient | ModbusSerialClient
PAPER = load_scenario("paper_x200")
TIMEOUT_S = 1.0
LINES = {"tcp": 0b001, "rtu": 0b010, "serial": 0b100}
REPLIES = [trouble for trouble in LineFault if trouble is not LineFault.SILENT]


@dataclass
class Troubled:
    """A bench without its loop on all three lines, and a fault-free access to its control registers."""

    port: int
    rtu: str
    stand: str
    control: ModbusTcpClient
    machine: LoadTrain
    now_ns: Callable[[], int]

    def order(self, trouble: LineFault, line: str, count: int = 1, wait_s: float = 0.1) -> None:
        words = [list(LineFault).index(trouble) + 1, LINES[line], count, round(wait_s * 100)]
        assert not self.control.write_registers(900, words, device_id=UNIT).isError()

    @contextlib.contextmanager
    def master(self, line: str) -> Iterator[Client]:
        client: Client = (
            ModbusTcpClient("127.0.0.1", port=self.port, timeout=TIMEOUT_S, retries=0)
            if line == "tcp"
            else ModbusSerialClient(self.rtu, framer=FramerType.RTU, baudrate=19_200, timeout=TIMEOUT_S, retries=0)
        )
        try:
            assert client.connect()
            yield client
        finally:
            client.close()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Troubled]:
    scenario = replace(PAPER, scan=replace(PAPER.scan, width_px=64, height_px=55, frame_time_s=6.0))
    # At this rate nothing advances the machine between requests.
    with running_bench(scenario, 5.0, tmp_path_factory.mktemp("export")) as parts:
        troubles, now_ns = parts.registers.line_faults, parts.clock.now_ns
        control = ModbusTcpClient("127.0.0.1", port=parts.port, timeout=20, retries=0)
        assert control.connect()
        assert control.socket is not None
        troubles.exempt(control.socket.getsockname()[1])
        with rtu_line(parts.port, UNIT, troubles) as rtu, ascii_line(parts.machine, now_ns, troubles) as (stand, _):
            yield Troubled(parts.port, rtu, stand, control, parts.machine, now_ns)
        control.close()


@pytest.fixture(autouse=True)
def no_faults(bench: Troubled) -> Iterator[None]:
    yield
    assert not bench.control.write_registers(900, [0, 0, 0, 0], device_id=UNIT).isError()


def requested(client: Client, address: int, count: int) -> list[int] | None:
    """Registers, or None where the master reports an error."""
    try:
        answer = client.read_input_registers(address, count=count, device_id=UNIT)
    except ModbusException:
        return None
    return None if answer.isError() else list(answer.registers)


@pytest.mark.parametrize("line", ["tcp", "rtu"])
@pytest.mark.parametrize("trouble", REPLIES)
def test_a_master_gets_the_truth_or_an_error_and_then_the_truth_again(bench: Troubled, line: str, trouble: LineFault) -> None:
    with bench.master(line) as client:
        assert requested(client, 0, 2) == [0x5E31, 1]
        bench.order(trouble, line, wait_s=0.1)
        spoilt = requested(client, 0, 2)
        # An echo over TCP has the right transaction number: pymodbus takes it for an answer without registers.
        assert spoilt in (None, [0x5E31, 1]) or (line, trouble, spoilt) == ("tcp", LineFault.ECHO, [])
        if trouble in (LineFault.LATE, LineFault.SPLIT, LineFault.TWICE):
            assert spoilt is not None  # within the master's timeout
        if trouble is LineFault.LOST or (line, trouble) == ("rtu", LineFault.WRONG_CHECK):
            assert spoilt is None
        time.sleep(0.15)  # what comes late has come
        if not client.connected:
            assert client.connect()
        assert [requested(client, 0, 2) for _ in range(2)][-1] == [0x5E31, 1]


@pytest.mark.parametrize("line", ["tcp", "rtu"])
def test_a_reply_later_than_the_masters_timeout_is_an_error(bench: Troubled, line: str) -> None:
    with bench.master(line) as client:
        bench.order(LineFault.LATE, line, wait_s=2 * TIMEOUT_S)
        assert requested(client, 0, 2) is None


@pytest.mark.parametrize("line", ["tcp", "rtu"])
def test_a_lost_reply_has_acted_and_a_silent_device_has_not(bench: Troubled, line: str) -> None:
    def beat(word: int) -> None:
        with bench.master(line) as client, contextlib.suppress(ModbusException):
            client.write_register(6, word, device_id=UNIT)

    def reported() -> list[int]:
        return list(bench.control.read_holding_registers(6, count=1, device_id=UNIT).registers)

    bench.order(LineFault.LOST, line)
    beat(21)
    assert reported() == [21]
    bench.order(LineFault.SILENT, line, wait_s=1.5 * TIMEOUT_S)
    beat(22)
    assert reported() == [21]
    time.sleep(TIMEOUT_S)
    beat(23)
    assert reported() == [23]


def test_trouble_counts_replies_and_keeps_to_its_line(bench: Troubled) -> None:
    with bench.master("tcp") as tcp, bench.master("rtu") as rtu:
        bench.order(LineFault.LOST, "rtu", count=2)
        assert requested(tcp, 0, 2) is not None
        assert [requested(rtu, 0, 2) is None for _ in range(3)] == [True, True, False]


def test_the_driver_reports_link_error_or_the_truth_and_a_new_link_works(bench: Troubled) -> None:
    bench.machine.ramp_to(200.0, 100.0)
    wait_until(lambda: bench.machine.read(bench.now_ns()).force_n > 195.0)
    settings = {"port": bench.port, "timeout_s": TIMEOUT_S, "watchdog_s": 0.0}
    for trouble in REPLIES:
        device = open_load_frame(settings, WallClock())
        bench.order(trouble, "tcp", wait_s=0.05)
        reported_n = None
        with contextlib.suppress(LinkError):
            reported_n = device.read().force_n
        device.close()
        assert reported_n is None or abs(reported_n - 200.0) < 10
        assert reported_n is not None or trouble not in (LineFault.LATE, LineFault.SPLIT, LineFault.TWICE)
        assert reported_n is None or trouble not in (LineFault.LOST, LineFault.WRONG_CHECK)
        bench.order(LineFault.TWICE, "tcp", count=0)  # an order for no reply at all
        again = open_load_frame(settings, WallClock())
        assert abs(again.read().force_n - 200.0) < 10
        again.close()
    bench.machine.ramp_to(0.0, 100.0)


@pytest.mark.parametrize(
    ("trouble", "expected_reply"),
    [
        (LineFault.LATE, b"S M\r\n"),
        (LineFault.LOST, b""),
        (LineFault.NOISE, b"\xc3\x5a\xf1S M\r\n"),
        (LineFault.WRONG_CHECK, b"\xd3 M\r\n"),
        (LineFault.SPLIT, b"S M\r\n"),
        (LineFault.ECHO, b"pS M\r\n"),
        (LineFault.TWICE, b"S M\r\nS M\r\n"),
        (LineFault.SILENT, b""),
    ],
)
def test_letters_over_pyserial(bench: Troubled, trouble: LineFault, expected_reply: bytes) -> None:
    with serial.Serial(bench.stand, 115_200) as port:

        def received(expected: bytes) -> bytes:
            """As much as is wanted, however long that takes, and what comes then unasked."""
            port.timeout = 20.0 if expected else 0.0
            first = port.read(len(expected))
            port.timeout = 0.25
            return first + port.read(64)

        bench.order(trouble, "serial", wait_s=30.0 if trouble is LineFault.SILENT else 0.1)
        began = time.monotonic()
        port.write(b"p")
        assert received(expected_reply) == expected_reply
        if trouble is LineFault.SILENT:
            assert not bench.control.write_registers(900, [0, 0, 0, 0], device_id=UNIT).isError()
        if trouble in (LineFault.LATE, LineFault.SPLIT, LineFault.TWICE):
            assert time.monotonic() - began > 0.1
        port.write(b"p")
        assert received(b"S M\r\n") == b"S M\r\n"


@pytest.mark.parametrize("words", [[10, 1, 1, 1], [1, 8, 1, 1]])
def test_an_unknown_trouble_or_line_is_refused(bench: Troubled, words: list[int]) -> None:
    assert bench.control.write_registers(900, words, device_id=UNIT).exception_code == 3


def test_a_scenario_plans_trouble_for_a_while(tmp_path: Path) -> None:
    path = tmp_path / "troubled.yaml"
    path.write_text(
        "extends: paper_x200\nfaults:\n"
        "  - {at_s: 20.0, lasts_s: 10.0, what: lost, line: tcp}\n"
        "  - {at_s: 25.0, lasts_s: 40.0, what: late, wait_s: 0.01}\n"
        "  - {at_s: 2.0, what: grip_slip, slip_mm: 0.01}\n"
    )
    scenario = load_scenario(str(path))
    clock = BenchClock(20.0, lambda _: None)
    machine = LoadTrain(scenario, clock.start_ns)
    sem = Sem(scenario, clock, machine, tmp_path, True, lambda _: None, lambda _: None)
    registers = BenchRegisters(scenario, clock, machine, sem)
    troubles, now = registers.line_faults, clock.start_ns

    def what(line: Line) -> LineFault | None:
        found = troubles.take(line, troubles.mark())
        return found.kind if found else None

    observed: list[tuple[LineFault | None, LineFault | None]] = []
    clock.now_ns = lambda: now  # type: ignore[method-assign]
    for second in (19, 21, 26, 31, 66):
        now = clock.start_ns + second * 1_000_000_000
        observed.append((what(Line.TCP), what(Line.RTU)))
    late, lost = LineFault.LATE, LineFault.LOST
    assert observed == [(None, None), (lost, None), (lost, late), (late, late), (None, None)]


def test_nothing_is_slower_for_it(bench: Troubled) -> None:
    with bench.master("tcp") as client:
        began = time.process_time()
        for _ in range(50):
            assert requested(client, 4, 2) is not None
        assert (time.process_time() - began) / 50 < 0.02  # the driver asks every 25 ms
