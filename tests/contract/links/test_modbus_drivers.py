"""The Modbus drivers against real servers in processes of their own."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator

import pytest

from semlive.data.loading import MotionState, StageKind, StopOnLinkLoss
from semlive.errors import BadConfig, LinkError, LinkRefused
from semlive.ports import BlindStop, LoadFrame, Stage, Trigger
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.load_frame import open_load_frame
from semlive_drivers.modbus.registers import Kind
from semlive_drivers.modbus.stage import open_stage
from semlive_drivers.modbus.tcp.link import ModbusLink
from semlive_drivers.modbus.trigger import open_trigger

from ...clocks import MonotonicClock
from ...waiting import wait_until
from .processes import Peer, peer

CLOCK = MonotonicClock()


@pytest.fixture
def bench() -> Iterator[Peer]:
    with peer() as running:
        yield running


@pytest.fixture
def load_frame(bench: Peer) -> Iterator[LoadFrame]:
    device = open_load_frame({"port": bench.port, "watchdog_s": 2.0, "frozen_after_s": 1.0, "timeout_s": 1.0}, CLOCK)
    yield device
    device.close()


def test_a_load_frame_reports_who_it_is(bench: Peer, load_frame: LoadFrame) -> None:
    assert isinstance(load_frame, LoadFrame)
    identity = load_frame.identity
    assert identity.name == f"load frame at 127.0.0.1:{bench.port} unit 1"
    assert identity.simulated
    assert identity.stop_on_link_loss is StopOnLinkLoss.ASSUMED
    assert identity.force_max_n == 4300.0
    assert bench.peek(7, 1) == [20]


def test_what_was_found_out_at_the_machine_wins_and_without_watchdog_there_is_none(bench: Peer) -> None:
    for settings, statement in (
        ({"stop_on_link_loss": "verified"}, StopOnLinkLoss.VERIFIED),
        ({"watchdog_s": 0.0}, StopOnLinkLoss.NONE),
    ):
        device = open_load_frame({"port": bench.port, **settings}, CLOCK)
        assert device.identity.stop_on_link_loss is statement
        device.close()


def test_a_ramp_is_taken_moves_and_arrives(bench: Peer, load_frame: LoadFrame) -> None:
    load_frame.ramp_to(123.5, 10.0)
    sample = load_frame.read()
    assert (sample.sequence, sample.motion, sample.target_n, sample.extension_mm) == (0, MotionState.MOVING, 123.5, 0.25)
    assert len(sample.raw) == 13
    wait_until(lambda: load_frame.read().motion is MotionState.STOPPED)
    assert load_frame.read().force_n == 123.5
    assert bench.commands == 1


def test_a_stop_is_taken_and_repeats_the_last_target(bench: Peer, load_frame: LoadFrame) -> None:
    load_frame.ramp_to(50.0, 10.0)
    load_frame.stop()
    assert load_frame.read().motion is MotionState.STOPPED
    assert bench.peek(0, 5) == [*struct.unpack(">HH", struct.pack(">f", 50.0)), *struct.unpack(">HH", struct.pack(">f", 10.0)), 2]


def test_every_reading_feeds_the_watchdog(bench: Peer, load_frame: LoadFrame) -> None:
    for _ in range(5):
        load_frame.read()
    assert bench.peek(912, 1) == [5]


def test_a_frozen_counter_is_no_reading(bench: Peer, load_frame: LoadFrame) -> None:
    load_frame.read()
    bench.misbehave(1)
    load_frame.read()
    time.sleep(1.05)
    with pytest.raises(LinkError, match=r"is frozen: no new value for [1-9]"):
        load_frame.read()


@pytest.mark.parametrize(
    ("mode", "sentence"),
    [(2, "register 4 holds nan, which is no reading"), (4, "reports motion state 9, which does not exist")],
)
def test_implausible_registers_give_no_reading(bench: Peer, load_frame: LoadFrame, mode: int, sentence: str) -> None:
    bench.misbehave(mode)
    with pytest.raises(LinkError, match=sentence):
        load_frame.read()


def test_a_command_that_was_not_taken_is_an_error(bench: Peer, load_frame: LoadFrame) -> None:
    bench.misbehave(3)
    with pytest.raises(LinkError, match="did not take the command"):
        load_frame.ramp_to(10.0, 1.0)


def test_an_exception_reply_is_reported_as_text(bench: Peer, load_frame: LoadFrame) -> None:
    bench.misbehave(5)
    with pytest.raises(LinkError, match=r"refused writing holding register 0: the device is busy \(exception 6\)"):
        load_frame.ramp_to(10.0, 1.0)


def test_a_register_that_does_not_exist(bench: Peer) -> None:
    registers = {"motion": {"address": 990}, "force": {"address": 999}}
    with pytest.raises(BadConfig, match="do not fit into one request"):
        open_load_frame({"port": bench.port, "registers": registers}, CLOCK)
    moved = {name: {"address": 2000 + 2 * i} for i, name in enumerate(("motion", "x", "y", "counter"))}
    stage = open_stage({"port": bench.port, "registers": moved}, CLOCK)
    with pytest.raises(LinkError, match=r"there is no such register \(exception 2\)"):
        stage.read()
    stage.close()


def test_another_device_is_refused(bench: Peer) -> None:
    bench.misbehave(6)
    with pytest.raises(LinkRefused, match="is another device: its identity is 0x1234 instead of 0x5e31; check host and unit"):
        open_load_frame({"port": bench.port}, CLOCK)
    open_load_frame({"port": bench.port, "identity": None}, CLOCK).close()


def test_nobody_listens() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    for factory in (open_load_frame, open_stage, open_trigger):
        with pytest.raises(LinkRefused, match=f"no device answers at 127.0.0.1:{port}; check that the device is on"):
            factory({"port": port}, CLOCK)


def test_a_server_that_accepts_and_never_answers_costs_one_timeout() -> None:
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        began_s = time.monotonic()
        with pytest.raises(LinkError, match=r"gave no answer within 1 s while reading input register 0"):
            open_load_frame({"port": mute.getsockname()[1], "timeout_s": 1.0}, CLOCK)
        assert time.monotonic() - began_s < 2.0  # less than two of them


def test_a_server_that_hangs_costs_one_timeout_and_then_nothing(bench: Peer, load_frame: LoadFrame) -> None:
    load_frame.read()
    bench.pause()
    began_s = time.monotonic()
    with pytest.raises(LinkError, match="gave no answer within"):
        load_frame.read()
    assert time.monotonic() - began_s < 2.0  # less than two of them
    bench.go_on()
    began_s = time.monotonic()
    with pytest.raises(LinkError, match=r"the link to .* is closed; it must be opened again"):
        load_frame.read()
    assert time.monotonic() - began_s < 0.5  # half of one


def test_a_server_that_dies(bench: Peer, load_frame: LoadFrame) -> None:
    load_frame.read()
    bench.kill()
    with pytest.raises(LinkError):
        load_frame.read()
    load_frame.close()
    load_frame.close()


def test_a_stage_stops_without_an_answer_and_its_link_must_then_be_opened_again(bench: Peer) -> None:
    stage = open_stage({"port": bench.port}, CLOCK)
    assert isinstance(stage, BlindStop)
    stage.move_to(4.0, 5.0)
    assert stage.read().motion is MotionState.MOVING
    assert stage.stop_blind()
    with pytest.raises(LinkError, match="is closed; it must be opened again"):
        stage.read()
    stage.close()
    assert stage.stop_blind()
    again = open_stage({"port": bench.port}, CLOCK)
    assert again.read().motion is MotionState.STOPPED
    again.close()


def test_a_stage_moves_to_its_commanded_position(bench: Peer) -> None:
    stage = open_stage({"port": bench.port, "kind": "beam"}, CLOCK)
    assert isinstance(stage, Stage)
    assert stage.kind is StageKind.BEAM
    assert stage.identity.stop_on_link_loss is StopOnLinkLoss.NONE
    stage.move_to(10.5, -3.25)
    assert stage.read().motion is MotionState.MOVING
    stage.stop()
    sample = stage.read()
    assert (sample.x_um, sample.y_um, sample.motion) == (10.5, -3.25, MotionState.STOPPED)
    stage.close()


def test_a_trigger_asks_for_one_frame(bench: Peer) -> None:
    trigger = open_trigger({"port": bench.port}, CLOCK)
    assert isinstance(trigger, Trigger)
    trigger.scan_once()
    assert bench.peek(200, 1) == [1]
    bench.misbehave(5)
    with pytest.raises(LinkError, match="the device is busy"):
        trigger.scan_once()
    trigger.close()


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"prot": 502}, "modbus load frame: prot: extra inputs are not permitted; it has host, port"),
        ({"port": 0}, "modbus load frame: port: input should be greater than or equal to 1"),
        ({"registers": {"farce": {"address": 1}}}, "has no register called 'farce'; it has identity"),
        ({"registers": {"force": {"adress": 1}}}, "registers.force has no field 'adress'; it has address"),
        ({"registers": {"force": {"dtype": "f80"}}}, "registers.force.dtype is 'f80'"),
        ({"registers": {"force": {"address": 70000}}}, "register address 70000 does not exist"),
    ],
)
def test_settings_are_checked_before_anybody_is_called(settings: dict[str, object], sentence: str) -> None:
    with pytest.raises(BadConfig, match=sentence):
        open_load_frame(settings, CLOCK)


def test_drivers_work_with_an_independent_modbus_stack() -> None:
    with peer("modbus_tk_server.py") as other:
        load_frame = open_load_frame({"port": other.port}, CLOCK)
        assert not load_frame.identity.simulated
        assert load_frame.identity.stop_on_link_loss is StopOnLinkLoss.NONE
        sample = load_frame.read()
        assert (sample.force_n, sample.extension_mm, sample.target_n) == (-12.5, 0.125, 100.0)
        assert sample.simulator_lag_s is None
        load_frame.ramp_to(33.25, 2.0)
        load_frame.stop()
        stage = open_stage({"port": other.port}, CLOCK)
        assert stage.read().motion is MotionState.MOVING
        assert stage.read().x_um == 10.5
        stage.move_to(1.0, 2.0)
        with pytest.raises(LinkError, match="exception 2"):
            open_trigger({"port": other.port, "registers": {"scan": {"address": 500}}}, CLOCK).scan_once()
        load_frame.close()
        stage.close()


def test_single_bits_are_read_and_written(bench: Peer) -> None:
    link = ModbusLink("127.0.0.1", bench.port, 1, 0.5)
    bit = Block(Kind.COIL, 0, 1)
    assert link.read(bit) == (0,)
    link.write(0, [1], Kind.COIL, single=True)
    assert link.read(bit) == (1,)
    link.write(0, [0], Kind.COIL)
    assert (link.read(bit), link.read(Block(Kind.DISCRETE, 0, 1))) == ((0,), (0,))
    link.close()
