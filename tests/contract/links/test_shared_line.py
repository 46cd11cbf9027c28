"""Two devices on one pair of wires, each with a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from semlive.errors import BadConfig, LinkError
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.device import open_link
from semlive_drivers.modbus.registers import Kind
from semlive_drivers.modbus.rtu.shared_line import PriorityLock, is_shared
from semlive_drivers.modbus.settings import ModbusSettings

from ...waiting import wait_until
from .emulated import Device, over_rtu

FRAME, STAGE = 1, 2
PROBE = Block(Kind.HOLDING, 0, 4)


@pytest.fixture
def devices() -> dict[int, Device]:
    return {unit: Device({address: 1000 * unit + address for address in range(40)}) for unit in (FRAME, STAGE)}


@pytest.fixture
def late() -> list[float]:
    return []


@pytest.fixture
def path(devices: dict[int, Device], late: list[float]) -> Iterator[str]:
    with over_rtu(devices, lambda: late.pop(0) if late else 0.0) as path:
        yield path


def settings(path: str, unit: int, timeout_s: float = 5.0, **serial: object) -> ModbusSettings:
    line = {"port": path, "baud": 115_200, "slowest_s": 0.2, **serial}
    return ModbusSettings.model_validate({"serial": line, "unit": unit, "timeout_s": timeout_s})


def test_two_threads_read_and_write_concurrently_and_get_their_own_replies(path: str, devices: dict[int, Device]) -> None:
    wrong: list[object] = []

    def work(unit: int) -> None:
        link = open_link(settings(path, unit), None, (PROBE,))
        for turn in range(60):
            address = turn % 30
            if link.read(Block(Kind.HOLDING, address, 2)) != (1000 * unit + address, 1000 * unit + address + 1):
                wrong.append((unit, address))
            link.write(39, [turn])
        link.close()

    threads = [threading.Thread(target=work, args=(unit,)) for unit in devices]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(100.0)
    assert not wrong
    assert [device.words[39] for device in devices.values()] == [59, 59]
    assert not is_shared(path)


def test_a_device_that_falls_silent_or_is_late_does_not_harm_its_neighbour(
    path: str, devices: dict[int, Device], late: list[float]
) -> None:
    frame, stage = (open_link(settings(path, unit, 0.4, slowest_s=0.8), None, (PROBE,)) for unit in (FRAME, STAGE))
    late[:] = [0.6]
    with pytest.raises(LinkError, match=f"unit {STAGE} gave no answer"):
        stage.read(Block(Kind.HOLDING, 3, 1))
    # The stage's answer comes while the frame asks: it is nobody's, and the frame's own is requested again.
    try:
        assert frame.read(Block(Kind.HOLDING, 3, 1)) == (1003,)
    except LinkError:
        wait_until(frame.resync)
    assert frame.read(Block(Kind.HOLDING, 4, 1)) == (1004,)
    wait_until(stage.resync)
    assert stage.read(Block(Kind.HOLDING, 3, 1)) == (2003,)
    devices[STAGE].silent = True
    with pytest.raises(LinkError):
        stage.read(Block(Kind.HOLDING, 3, 1))
    stage.close()
    assert frame.read(Block(Kind.HOLDING, 5, 1)) == (1005,)
    frame.close()


def test_a_stop_waits_for_one_answer_of_its_neighbour_at_most(path: str, devices: dict[int, Device]) -> None:
    frame, stage = (open_link(settings(path, unit, 0.5), None, (PROBE,)) for unit in (FRAME, STAGE))
    over = threading.Event()
    worst_s = 0.0

    def look_for_it() -> None:
        while not over.is_set():
            try:
                stage.read(Block(Kind.HOLDING, 0, 1))
            except LinkError:
                stage.resync()

    devices[STAGE].silent = True
    thread = threading.Thread(target=look_for_it)
    thread.start()
    for _ in range(5):
        began = time.monotonic()
        frame.write(39, [2])
        worst_s = max(worst_s, time.monotonic() - began)
        time.sleep(0.03)
    over.set()
    thread.join()
    assert worst_s < 2 * 0.5  # one time-out, the silence after it, and a busy computer; but not two
    for link in (frame, stage):
        link.close()


def test_whoever_shares_a_line_reports_the_same_of_it(path: str) -> None:
    frame = open_link(settings(path, FRAME), None, (PROBE,))
    with pytest.raises(BadConfig, match="shared by devices that differ: baud is 115200 for one and 9600 for another"):
        open_link(settings(path, STAGE, baud=9600), None, (PROBE,))
    frame.close()
    assert not is_shared(path)


def test_a_link_to_the_line_is_the_line(path: str, tmp_path: Path) -> None:
    name = tmp_path / "semlive-frame"
    name.symlink_to(path)
    frame, stage = open_link(settings(path, FRAME), None, (PROBE,)), open_link(settings(str(name), STAGE), None, (PROBE,))
    assert (frame.read(Block(Kind.HOLDING, 1, 1)), stage.read(Block(Kind.HOLDING, 1, 1))) == ((1001,), (2001,))
    frame.close()
    assert is_shared(path)
    stage.close()
    assert not is_shared(path)


def test_a_line_that_is_gone_is_opened_again_by_both(path: str) -> None:
    frame, stage = (open_link(settings(path, unit), None, (PROBE,)) for unit in (FRAME, STAGE))
    frame._line._line._port._port.close()  # type: ignore[attr-defined]  # as if the adapter had been pulled
    with pytest.raises(LinkError, match=r"serial line .* is gone"):
        frame.read(PROBE)
    again = open_link(settings(path, FRAME), None, (PROBE,))
    with pytest.raises(LinkError, match=r"serial line .* is gone"):
        stage.read(PROBE)
    both = open_link(settings(path, STAGE), None, (PROBE,))
    assert (again.read(PROBE)[0], both.read(PROBE)[0]) == (1000, 2000)
    for link in (frame, stage, again, both):
        link.close()


def test_who_comes_first_is_served_first_and_urgent_ones_before() -> None:
    turns, served, started = PriorityLock(), list[str](), threading.Event()

    def want(name: str, urgent: bool) -> threading.Thread:
        def run() -> None:
            with turns.acquired(urgent):
                served.append(name)

        thread = threading.Thread(target=run)
        waiting = sum(map(len, turns._waiting))
        thread.start()
        wait_until(lambda: sum(map(len, turns._waiting)) > waiting)
        return thread

    with turns.acquired(False):
        started.set()
        threads = [want("a", False), want("b", False), want("stop", True), want("stop too", True)]
    for thread in threads:
        thread.join()
    assert served == ["stop", "stop too", "a", "b"]
