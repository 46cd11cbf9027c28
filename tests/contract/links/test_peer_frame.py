"""The Modbus driver against a load frame that shares no code with semlive, with one fault at a time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from semlive.data.loading import LoadSample, MotionState
from semlive.errors import LinkError
from semlive.ports import BlindStop, OrderCheck
from semlive_drivers.composite_load_frame import CompositeLoadFrame
from semlive_drivers.modbus.load_frame import open_load_frame

from ...clocks import MonotonicClock
from ...waiting import wait_until
from .peer_frame import Peer, buildable, compiled, running

CLOCK = MonotonicClock()
ON_THE_WIRE_S = 0.1
Opened = Callable[..., CompositeLoadFrame]


@pytest.fixture(scope="module")
def frame_peer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The independent frame, compiled here."""
    if not buildable():
        pytest.skip("libmodbus, a C compiler or the source of the independent frame is not there")
    return compiled(tmp_path_factory.mktemp("peer"))


@pytest.fixture
def peer(frame_peer: Path, tmp_path: Path) -> Iterator[Peer]:
    with running(frame_peer, tmp_path) as started:
        yield started


@pytest.fixture
def opened(peer: Peer) -> Iterator[Opened]:
    with ExitStack() as stack:

        def open_it(name: str, **settings: object) -> CompositeLoadFrame:
            frame = open_load_frame({"map": peer.map(name), "port": peer.port, "confirmed": True, **settings}, CLOCK)
            stack.callback(frame.close)
            return frame

        yield open_it


def test_an_order_does_not_write_the_registers_between_its_own(peer: Peer, opened: Opened) -> None:
    frame = opened("i16")
    frame.ramp_to(30.0, 100.0)
    wait_until(lambda: peer.force_n == pytest.approx(30.0))
    frame.read()
    frame.stop()
    frame.stop_blind()
    assert peer.now()[-2:] == ["r11=777", "r13=5000"]


def test_orders_that_sixteen_bits_do_not_hold_are_refused_and_nothing_moves(peer: Peer, opened: Opened) -> None:
    frame = opened("i16")
    assert isinstance(frame, OrderCheck)
    assert frame.order_problem(300.0, 30.0) is None
    assert "0.04 N/s is less than one count of rate" in str(frame.order_problem(300.0, 0.04))
    assert "3500 does not fit" in str(frame.order_problem(3500.0, 30.0))
    for force_n, rate_n_s in ((300.0, 0.04), (3500.0, 30.0)):
        with pytest.raises(LinkError):
            frame.ramp_to(force_n, rate_n_s)
    assert "REQ" not in peer.text()


@pytest.mark.parametrize("fault", ["delay 500", "badtid 1", "rst 1"])
@pytest.mark.parametrize("name", ["f32", "i16"])
def test_a_stop_is_written_at_once_after_a_failed_request(peer: Peer, opened: Opened, fault: str, name: str) -> None:
    frame = opened(name)
    assert isinstance(frame, BlindStop)
    frame.ramp_to(300.0, 5.0)
    peer.switch(fault)
    with pytest.raises(LinkError):
        wait_until(lambda: frame.read().force_n > 300.0)
    began_s = time.monotonic()
    assert frame.stop_blind()
    written_s = time.monotonic() - began_s
    with pytest.raises(LinkError, match="is closed; it must be opened again"):
        frame.read()
    assert written_s < ON_THE_WIRE_S + 0.05  # it lingers for an answer after it has written
    late_s = float(fault.split()[1]) / 1000 if "delay" in fault else 0.0
    # A late device works on one request at a time: the read that failed, then the stop.
    wait_until(lambda: not peer.moves)
    assert peer.times_s("<STOP>")[0] - began_s < ON_THE_WIRE_S + late_s
    assert peer.times_s("STOPPED")[0] - began_s < ON_THE_WIRE_S + 2 * late_s


def test_a_stop_is_repeated_until_one_gets_through(peer: Peer, opened: Opened) -> None:
    frame = opened("f32")
    frame.ramp_to(300.0, 5.0)
    peer.switch("rst 12")
    with pytest.raises(LinkError):
        frame.read()
    frame.close()
    began_s, stops = time.monotonic(), 0
    while peer.moves and stops < 40:
        assert frame.stop_blind()
        stops += 1
    assert stops <= 12
    assert time.monotonic() - began_s < 5.0


def test_a_stop_that_was_not_answered_comes_first_on_the_next_connection(peer: Peer, opened: Opened) -> None:
    frame = opened("f32")
    frame.ramp_to(300.0, 5.0)
    peer.switch("hole 1")
    with pytest.raises(LinkError):
        frame.read()
    for _ in range(3):
        assert frame.stop_blind()
    frame.close()
    assert not peer.times_s("<STOP>")
    peer.switch("hole 0")
    again = opened("f32")
    assert not peer.moves
    assert again.read().force_n < 10.0


def test_a_stop_finds_nobody(frame_peer: Path, tmp_path: Path) -> None:
    with running(frame_peer, tmp_path) as peer:
        frame = open_load_frame({"map": peer.map("f32"), "port": peer.port, "confirmed": True}, CLOCK)
        frame.ramp_to(300.0, 5.0)
    with pytest.raises(LinkError):
        frame.read()
    frame.stop_blind()
    began_s = time.monotonic()
    assert not frame.stop_blind()
    assert time.monotonic() - began_s < 0.5
    frame.close()


def until_it_rests(frame: CompositeLoadFrame) -> list[LoadSample]:
    """All readings until the frame reports that it is stationary."""
    observed = [frame.read()]
    wait_until(lambda: (observed.append(frame.read()), observed[-1].motion is MotionState.STOPPED)[1])
    return observed


@pytest.mark.parametrize("name", ["f32", "f32c", "i16", "disp"])
def test_a_healthy_frame_raises_no_alarm(peer: Peer, opened: Opened, name: str) -> None:
    approach = {"approach": {"stiffness_n_mm": 20000, "speed_max_mm_s": 0.05}} if name == "disp" else {}
    frame = opened(name, **approach)
    observed = [frame.read()]
    for target_n in (60.0, 20.0):
        frame.ramp_to(target_n, 100.0)
        observed += until_it_rests(frame)
        assert observed[-1].force_n == pytest.approx(target_n, abs=1.5)
        frame.stop()
        observed += [frame.read() for _ in range(3)]
    assert {sample.order_changed for sample in observed} == {None}


@pytest.mark.parametrize("name", ["f32", "i16"])
@pytest.mark.parametrize(("restart", "holds"), [("reboot 380", "0 N"), ("reboot 0", "0 N")])
def test_a_frame_that_was_restarted_holds_other_orders(peer: Peer, opened: Opened, name: str, restart: str, holds: str) -> None:
    frame = opened(name)
    frame.ramp_to(300.0, 30.0)
    assert frame.read().order_changed is None
    peer.switch(restart)
    changed = frame.read().order_changed
    assert changed is not None
    assert f"holds {holds}, 300 N was written: its registers were cleared, so it was restarted" in changed
    frame.stop()


@pytest.mark.parametrize("name", ["f32", "i16"])
def test_an_order_of_an_earlier_process_is_compared_with_what_the_frame_holds(peer: Peer, opened: Opened, name: str) -> None:
    first = opened(name)
    first.ramp_to(60.0, 100.0)
    until_it_rests(first)
    first.close()  # an orderly end sends a stop
    before = opened(name)
    before.recall_order(60.0, 100.0)
    assert [(item.order_changed, item.orders_cleared) for item in (before.read() for _ in range(3))] == [(None, False)] * 3
    before.close()
    other = opened(name)
    other.recall_order(80.0, 100.0)
    found = [other.read() for _ in range(2)]
    assert any("holds 60 N, 80 N was written: another program or a person commands it" in str(item.order_changed) for item in found)
    assert not any(item.orders_cleared for item in found)
    other.close()
    peer.switch("reboot 0")
    restarted = opened(name)
    restarted.recall_order(60.0, 100.0)
    found = [restarted.read() for _ in range(2)]
    assert any("holds 0 N, 60 N was written: its registers were cleared" in str(item.order_changed) for item in found)
    assert any(item.orders_cleared for item in found)
    restarted.stop()  # the operator has looked: the next reading compares with what the stop wrote
    restarted.ramp_to(80.0, 100.0)
    assert {item.order_changed for item in until_it_rests(restarted)} == {None}


def test_a_displacement_drive_holds_no_target_of_an_earlier_process(opened: Opened) -> None:
    frame = opened("disp", approach={"stiffness_n_mm": 20000, "speed_max_mm_s": 0.05})
    frame.recall_order(80.0, 100.0)
    assert [frame.read().order_changed for _ in range(3)] == [None] * 3


def test_a_second_master_is_noticed_at_the_next_reading(frame_peer: Path, tmp_path: Path) -> None:
    with running(frame_peer, tmp_path, clients=2) as peer:
        first, second = (open_load_frame({"map": peer.map("f32"), "port": peer.port, "confirmed": True}, CLOCK) for _ in range(2))
        first.ramp_to(100.0, 50.0)
        assert first.read().order_changed is None
        second.ramp_to(20.0, 50.0)
        assert "target (holding register 0) holds 20 N, 100 N was written" in str(first.read().order_changed)
        assert second.read().order_changed is None
        first.close()
        second.close()


def test_a_second_master_of_a_displacement_drive_ends_the_ramp(frame_peer: Path, tmp_path: Path) -> None:
    with running(frame_peer, tmp_path, clients=2) as peer:
        settings = {"map": peer.map("disp"), "port": peer.port, "confirmed": True}
        approach = {"approach": {"stiffness_n_mm": 20000, "speed_max_mm_s": 0.05}}
        first, second = (open_load_frame({**settings, **approach}, CLOCK) for _ in range(2))
        first.ramp_to(300.0, 20.0)
        assert first.read().order_changed is None
        second.ramp_to(-300.0, 60.0)
        assert "was written: another program or a person commands it" in str(first.read().order_changed)
        moves = peer.text().count("MOVE dir=1")
        first.read()
        assert peer.text().count("MOVE dir=1") == moves
        first.close()
        second.close()


def test_a_stiffness_in_the_wrong_unit_ends_the_ramp_within_few_newtons(peer: Peer, opened: Opened) -> None:
    frame = opened("disp", approach={"stiffness_n_mm": 20, "speed_max_mm_s": 2.0})  # kN/mm
    frame.ramp_to(300.0, 30.0)
    with pytest.raises(LinkError, match="the specimen is stiffer than stiffness_n_mm 20; correct it"):
        wait_until(lambda: frame.read().motion is MotionState.STOPPED)
    wait_until(lambda: not peer.moves)
    assert 0 < peer.force_n < 45.0
