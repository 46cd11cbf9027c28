"""Our server against masters of other makes, and our driver against their servers: mbpoll, libmodbus, modbus-tk, minimalmodbus,
over TCP and over a pair of pseudo-terminals that socat joins.

A test is skipped only where its peer is not installed, which .ci/run does not allow.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import minimalmodbus
import pytest
import serial
from modbus_tk import defines
from modbus_tk.modbus import Master
from modbus_tk.modbus_rtu import RtuMaster
from modbus_tk.modbus_tcp import TcpMaster

from semlive.data.loading import MotionState
from semlive.errors import LinkError
from semlive_drivers.modbus.check import check_modbus
from semlive_drivers.modbus.load_frame import open_load_frame
from semlive_simulators.load_frame.serial_lines import rtu_line
from semlive_simulators.load_frame.server import UNIT
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.machine import LoadTrain

from ...clocks import MonotonicClock
from ...waiting import wait_until
from ..running_bench import running_bench

CLOCK = MonotonicClock()
HERE = Path(__file__).parent
ORDER = [0x4316, 0, 0x42C8, 0, 1, 77]  # 150 N at 100 N/s, go, and a nonce


def f32(words: list[int]) -> float:
    return struct.unpack(">f", struct.pack(">HH", *words))[0]


@pytest.fixture(scope="module")
def mbpoll_peer() -> str:
    """The path of mbpoll."""
    path = shutil.which("mbpoll")
    if path is None:
        pytest.skip("mbpoll is not installed")
    return path


@pytest.fixture(scope="module")
def socat_peer() -> str:
    """The path of socat."""
    path = shutil.which("socat")
    if path is None:
        pytest.skip("socat is not installed")
    return path


@pytest.fixture(scope="module")
def libmodbus_peer(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A program of libmodbus, compiled here."""
    compiler = shutil.which("cc")
    if compiler is None or not Path("/usr/include/modbus/modbus.h").exists():
        pytest.skip("libmodbus or a C compiler is not installed")
    program = tmp_path_factory.mktemp("libmodbus") / "libmodbus_peer"
    subprocess.run([compiler, "-O1", "-o", program, HERE / "libmodbus_peer.c", "-lmodbus"], check=True, timeout=120)
    return str(program)


@dataclass
class Bench:
    """Where the simulated bench answers."""

    port: int
    rtu: str
    machine: LoadTrain

    def at_rest(self) -> None:
        """As it was found: the next test begins with a stopped frame."""
        self.machine.stop_load()


@contextmanager
def joined(socat: str, folder: Path, one: str, other: str) -> Iterator[tuple[str, str]]:
    """Two ends of a line: each a new pseudo-terminal by that name, or an existing one by its path."""
    ends = [folder / one, other if other.startswith("/") else folder / other]
    sides = [f"PTY,link={end},raw,echo=0" if isinstance(end, Path) else f"FILE:{end},raw,echo=0" for end in ends]
    process = subprocess.Popen([socat, *sides])
    try:
        wait_until(lambda: all(Path(end).exists() for end in ends))
        yield str(ends[0]), str(ends[1])
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    with running_bench(load_scenario("paper_x200"), 1.0) as parts, rtu_line(parts.port, UNIT, parts.registers.line_faults) as path:
        yield Bench(parts.port, path, parts.machine)


@pytest.fixture
def line(bench: Bench, socat_peer: str, tmp_path: Path) -> Iterator[str]:
    """The bench's serial line, as a peer opens it behind socat."""
    with joined(socat_peer, tmp_path, "master", bench.rtu) as (path, _):
        yield path
    bench.at_rest()


@contextmanager
def served(command: list[str]) -> Iterator[int]:
    """A peer's server; gives what it prints first."""
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield int(process.stdout.readline())
        finally:
            process.kill()


# ---------------------------------------------------------------- their masters, our server


def mbpoll(program: str, reach: list[str], *arguments: str) -> list[int]:
    """What mbpoll reads, by its own lines ``[3]:  0x5E31``."""
    target, *options = reach
    written = [argument for argument in arguments if argument.startswith("+")]
    options += [argument for argument in arguments if not argument.startswith("+")]
    command = [program, "-0", "-1", "-q", "-o", "3", "-a", "1", *options, target, *(value[1:] for value in written)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30)
    assert done.returncode == 0, done.stdout + done.stderr
    return [int(text.split(":")[1].strip().split()[0], 16) for text in done.stdout.splitlines() if text.startswith("[")]


@pytest.mark.parametrize("over", ["tcp", "rtu"])
def test_mbpoll_reads_and_drives_the_bench(bench: Bench, mbpoll_peer: str, over: str, request: pytest.FixtureRequest) -> None:
    if over == "tcp":
        reach = ["127.0.0.1", "-m", "tcp", "-p", str(bench.port)]
    else:
        reach = [request.getfixturevalue("line"), "-m", "rtu", "-b", "19200", "-P", "none"]
    printed = mbpoll(mbpoll_peer, reach, "-t", "3:hex", "-r", "0", "-c", "16")
    assert printed[:3] == [0x5E31, 1, 3]
    assert f32(printed[14:16]) == load_scenario("paper_x200").load_frame.force_limit_n
    mbpoll(mbpoll_peer, reach, "-t", "4:hex", "-r", "0", *(f"+{value}" for value in ORDER))
    assert mbpoll(mbpoll_peer, reach, "-t", "4:hex", "-r", "0", "-c", "6") == ORDER
    bench.at_rest()


@pytest.mark.parametrize("over", ["tcp", "rtu"])
def test_libmodbus_reads_and_drives_the_bench(bench: Bench, libmodbus_peer: str, over: str, request: pytest.FixtureRequest) -> None:
    where = str(bench.port) if over == "tcp" else request.getfixturevalue("line")
    done = subprocess.run([libmodbus_peer, "client", over, where], capture_output=True, text=True, timeout=30)
    assert done.returncode == 0, done.stderr
    printed = {key: [int(word, 16) for word in words] for key, *words in (text.split() for text in done.stdout.splitlines())}
    assert printed["inputs"][:3] == [0x5E31, 1, 3]
    assert printed["orders"] == ORDER
    assert printed["beyond"] == [1]
    bench.at_rest()


@contextmanager
def modbus_tk_master(bench: Bench, over: str, request: pytest.FixtureRequest) -> Iterator[Master]:
    if over == "tcp":
        master: Master = TcpMaster("127.0.0.1", bench.port, timeout_in_sec=3.0)
    else:
        master = RtuMaster(serial.Serial(request.getfixturevalue("line"), 19_200))
        master.set_timeout(3.0)
    try:
        yield master
    finally:
        master.close()


@pytest.mark.parametrize("over", ["tcp", "rtu"])
def test_modbus_tk_reads_and_drives_the_bench(bench: Bench, over: str, request: pytest.FixtureRequest) -> None:
    with modbus_tk_master(bench, over, request) as master:
        assert master.execute(UNIT, defines.READ_INPUT_REGISTERS, 0, 3) == (0x5E31, 1, 3)
        assert master.execute(UNIT, defines.WRITE_MULTIPLE_REGISTERS, 0, output_value=ORDER) == (0, 6)
        assert list(master.execute(UNIT, defines.READ_HOLDING_REGISTERS, 0, 6)) == ORDER
        assert master.execute(UNIT, defines.WRITE_SINGLE_REGISTER, 4, output_value=2) == (4, 2)
    bench.at_rest()


def test_minimalmodbus_reads_and_drives_the_bench(line: str) -> None:
    instrument = minimalmodbus.Instrument(line, UNIT)
    instrument.serial.baudrate, instrument.serial.timeout = 19_200, 1.0
    try:
        assert instrument.read_register(0, functioncode=4) == 0x5E31
        assert instrument.read_float(14, functioncode=4) == load_scenario("paper_x200").load_frame.force_limit_n
        instrument.write_registers(0, ORDER)
        assert instrument.read_registers(0, 6) == ORDER
        with pytest.raises(minimalmodbus.IllegalRequestError):
            instrument.read_register(16, functioncode=4)
    finally:
        instrument.serial.close()


# ---------------------------------------------------------------- our driver, their servers


def drive(settings: dict[str, object]) -> None:
    """Look, read, command and stop, against a server that does not answer."""
    found = check_modbus("bench", {"timeout_s": 3.0, **settings})
    assert {finding.what: finding.observation for finding in found.findings}["identity"] == "0x5e31"
    frame = open_load_frame({"timeout_s": 3.0, "frozen_after_s": 30.0, **settings}, CLOCK)
    assert not frame.identity.simulated
    sample = frame.read()
    assert (sample.force_n, sample.extension_mm, sample.target_n) == (-12.5, 0.125, 100.0)
    assert sample.motion is MotionState.STOPPED
    frame.ramp_to(33.25, 2.0)
    frame.stop()
    frame.close()


@pytest.mark.parametrize("over", ["tcp", "rtu"])
def test_our_driver_with_a_server_by_libmodbus(libmodbus_peer: str, over: str, socat_peer: str, tmp_path: Path) -> None:
    if over == "tcp":
        with served([libmodbus_peer, "server", "tcp", "0"]) as port:
            drive({"port": port, "registers": {"strain_gage": {"address": 200}}})
        return
    with joined(socat_peer, tmp_path, "device", "master") as (device, master), served([libmodbus_peer, "server", "rtu", device]):
        drive({"serial": {"port": master, "slowest_s": 0.2}, "registers": {"strain_gage": {"address": 200}}})


@pytest.mark.parametrize("over", ["tcp", "rtu"])
def test_our_driver_with_a_server_by_modbus_tk(over: str, socat_peer: str, tmp_path: Path) -> None:
    gage = {"registers": {"strain_gage": {"address": 200}}}
    if over == "tcp":
        with served([sys.executable, str(HERE / "modbus_tk_server.py")]) as port:
            drive({"port": port, **gage})
        return
    with (
        joined(socat_peer, tmp_path, "device", "master") as (device, master),
        served([sys.executable, str(HERE / "modbus_tk_rtu_server.py"), device]),
    ):
        drive({"serial": {"port": master, "slowest_s": 0.2}, **gage})


def test_a_line_whose_other_end_vanishes_is_an_error_and_no_reading(socat_peer: str, libmodbus_peer: str, tmp_path: Path) -> None:
    with joined(socat_peer, tmp_path, "device", "master") as (device, master), served([libmodbus_peer, "server", "rtu", device]):
        frame = open_load_frame({"serial": {"port": master, "slowest_s": 0.2}, "timeout_s": 1.0, "frozen_after_s": 30.0}, CLOCK)
        assert frame.read().force_n == -12.5
    with pytest.raises(LinkError):
        frame.read()
    frame.close()
