"""A device is driven by one process of the computer, whatever its run is called and however it is reached."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from semlive import process_lock
from semlive.cli.app import run_app
from semlive.data.checks import Verdict
from semlive.endpoints import addresses_of
from semlive.errors import LinkError, LinkRefused
from semlive.process_lock import Holder, ProcessLock
from semlive.service.checks.instrument import check_device_endpoints, endpoints_in
from semlive.service.config.configuration import Config
from semlive.service.config.sections import DriverSection
from semlive_drivers.endpoint_lock import reserve_serial, reserve_tcp
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.registers import Kind
from semlive_drivers.modbus.tcp.link import ModbusLink
from semlive_drivers.modbus.trigger import open_trigger

from ...clocks import MonotonicClock


@contextlib.contextmanager
def process(*words: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A process that reserves an endpoint, and its output."""
    holder = subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("endpoint_holder.py")), *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert holder.stdin is not None
    assert holder.stdout is not None
    try:
        yield holder, holder.stdout.readline().strip()
    finally:
        holder.kill()
        holder.wait()
        holder.stdin.close()
        holder.stdout.close()


@pytest.fixture
def server() -> Iterator[socket.socket]:
    """A server that accepts no connection until a test does."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(0.2)
        yield listening


def port_of(server: socket.socket) -> int:
    return int(server.getsockname()[1])


def test_a_second_process_is_refused_before_it_connects(server: socket.socket) -> None:
    port = port_of(server)
    with process("tcp", "127.0.0.1", str(port), "1") as (holder, printed):
        assert printed == "held"
        with pytest.raises(LinkRefused) as refused:
            ModbusLink("localhost", port, 1, 0.3)
        with pytest.raises(TimeoutError):
            server.accept()
    text = str(refused.value)
    assert f"localhost:{port} unit 1 is driven by another semlive already" in text
    if sys.platform == "linux":
        assert f"process {holder.pid} (user " in text
        assert "endpoint_holder.py tcp 127.0.0.1" in text


def test_the_lock_of_a_killed_process_is_released(server: socket.socket) -> None:
    words = "tcp", "127.0.0.1", str(port_of(server)), "1"
    with process(*words) as (holder, _):
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        with process(*words) as (_, printed):
            assert printed == "held"


def test_of_many_that_start_at_once_one_gets_it(server: socket.socket) -> None:
    words = "tcp", "127.0.0.1", str(port_of(server)), "1"
    with contextlib.ExitStack() as stack:
        opened: list[str] = []
        guard = threading.Lock()

        def start() -> None:
            held = process(*words)
            _, printed = held.__enter__()
            with guard:
                opened.append(printed)
                stack.push(held)

        threads = [threading.Thread(target=start) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(printed == "held" for printed in opened) == [False] * 7 + [True]


@pytest.mark.parametrize("name", ["localhost", "127.0.0.1", "::1", "0.0.0.0", "::ffff:127.0.0.1", socket.gethostname()])
def test_names_of_one_computer_are_one(server: socket.socket, name: str) -> None:
    port = port_of(server)
    reserved = reserve_tcp(name, port, 3)
    try:
        with process("tcp", "127.0.0.1", str(port), "3") as (_, printed):
            assert "unit 3 is driven by another semlive already" in printed
    finally:
        reserved.release()


def test_one_address_has_one_name() -> None:
    assert addresses_of("::ffff:192.0.2.7") == addresses_of("192.0.2.7") == ["192.0.2.7"]
    assert addresses_of("2001:db8:0::7") == ["2001:db8::7"]
    assert addresses_of("No-Such-Host.invalid.") == ["no-such-host.invalid"]


def test_units_of_one_gateway_and_other_ports_are_other_machines(server: socket.socket) -> None:
    port = port_of(server)
    endpoints = (str(port), "1"), (str(port), "2"), (str(port + 1), "1")
    with contextlib.ExitStack() as stack:
        assert [stack.enter_context(process("tcp", "127.0.0.1", *endpoint))[1] for endpoint in endpoints] == ["held"] * 3


def test_links_of_one_process_share_a_device_and_the_last_one_releases_it(server: socket.socket) -> None:
    port = port_of(server)
    first, second = ModbusLink("127.0.0.1", port, 1, 0.3), ModbusLink("localhost", port, 1, 0.3)
    for link, expected in ((first, False), (second, True)):
        link.close()
        link.close()
        with process("tcp", "127.0.0.1", str(port), "1") as (_, printed):
            assert (printed == "held") == expected


def test_a_thread_keeps_its_device_while_it_opens_a_failed_link_again(server: socket.socket) -> None:
    port, reopened, over = port_of(server), threading.Event(), threading.Event()
    failed: list[LinkError] = []

    def own_a_link() -> None:
        link = ModbusLink("127.0.0.1", port, 1, 0.1)
        try:
            link.read(Block(Kind.INPUT, 0, 1))  # nobody answers
        except LinkError as error:
            failed.append(error)
            link.close()
        reopened.set()
        over.wait(60)
        ModbusLink("127.0.0.1", port, 1, 0.1).close()

    owner = threading.Thread(target=own_a_link)
    owner.start()
    try:
        assert reopened.wait(60)
        assert failed
        with process("tcp", "127.0.0.1", str(port), "1") as (_, printed):
            assert f"process {os.getpid()}" in printed or sys.platform != "linux"
            assert "is driven by another semlive" in printed
    finally:
        over.set()
        owner.join()
    with process("tcp", "127.0.0.1", str(port), "1") as (_, printed):
        assert printed == "held"


def test_a_trigger_keeps_its_device_between_requests(server: socket.socket) -> None:
    port = port_of(server)
    trigger = open_trigger({"host": "127.0.0.1", "port": port}, MonotonicClock())
    with process("tcp", "127.0.0.1", str(port), "1") as (_, printed):
        assert "is driven by another semlive" in printed
    trigger.close()
    with process("tcp", "127.0.0.1", str(port), "1") as (_, printed):
        assert printed == "held"


def test_an_address_without_a_listener_stays_free() -> None:
    with socket.create_server(("127.0.0.1", 0)) as gone:
        port = port_of(gone)
    with pytest.raises(LinkRefused, match="no device answers"):
        ModbusLink("127.0.0.1", port, 1, 0.3)
    with process("tcp", "127.0.0.1", str(port), "1") as (_, printed):
        assert printed == "held"


def test_a_serial_line_is_one_by_whatever_link_it_is_reached(tmp_path: Path) -> None:
    master, slave = os.openpty()
    try:
        path = os.ttyname(slave)
        link = tmp_path / "by-id"
        link.symlink_to(path)
        with process("serial", str(link)) as (_, printed):
            assert printed == "held"
            with pytest.raises(LinkRefused, match="is driven by another semlive already"):
                reserve_serial(path)
        reserve_serial(path).release()
    finally:
        os.close(master)
        os.close(slave)


def test_frame_check_is_refused_while_a_run_holds_the_frame(
    server: socket.socket, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    port = port_of(server)
    with process("tcp", "127.0.0.1", str(port), "1"):
        monkeypatch.setattr(sys, "argv", ["semlive", "frame", "check", "bench", "--host", "127.0.0.1", "--port", str(port)])
        assert run_app() == 2
        with pytest.raises(TimeoutError):
            server.accept()
    assert f"127.0.0.1:{port} unit 1 is driven by another semlive already" in " ".join(capsys.readouterr().err.split())


def test_a_lock_file_is_one_lock_and_reports_who_holds_it(tmp_path: Path) -> None:
    path = tmp_path / "semlive.lock"
    first = process_lock.acquire_file(path)
    assert isinstance(first, ProcessLock)
    second = process_lock.acquire_file(path)
    assert isinstance(second, Holder)
    assert second.pid == os.getpid()
    assert second.user
    first.release()
    first.release()
    third = process_lock.acquire_file(path)
    assert isinstance(third, ProcessLock)
    third.release()
    assert path.stat().st_mode & 0o777 == 0o666


def test_what_a_holder_wrote_is_shown_without_control_characters(tmp_path: Path) -> None:
    path = tmp_path / "semlive.lock"
    held = process_lock.acquire_file(path)
    assert isinstance(held, ProcessLock)
    path.write_text("no number\n\x1b[2Jroot\n" + "x" * 10_000)
    printed = process_lock.acquire_file(path)
    held.release()
    assert isinstance(printed, Holder)
    assert (printed.pid, printed.user, len(printed.command)) == (0, "[2Jroot", 120)


def test_doctor_does_not_touch_a_device_held_by_a_run(server: socket.socket) -> None:
    port = port_of(server)
    (end,) = endpoints_in({"map": "bench", "host": "127.0.0.1", "port": port})
    frame = DriverSection(driver="modbus", settings={"map": "bench", "host": "127.0.0.1", "port": port})
    config = Config.model_validate(
        {"sem": {"folder": "export", "pixel_size_um": 1.0}, "stage": {"driver": "null"}, "protocol": {"calibration_shifts_px": [[0, 0]]}}
    ).model_copy(update={"load_frame": frame})
    assert end == ("127.0.0.1", port, 1)
    with process("tcp", "localhost", str(port), "1"):
        (found, *_) = check_device_endpoints(config)
        with pytest.raises(TimeoutError):
            server.accept()
    assert found.verdict is Verdict.FAILED
    assert f"127.0.0.1:{port} unit 1 is driven by another semlive already" in found.observation
    (found, *_) = check_device_endpoints(config)
    assert found.verdict is Verdict.OK
