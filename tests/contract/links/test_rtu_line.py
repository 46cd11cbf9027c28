"""Modbus RTU over a pseudo-terminal: answers that come late are never taken for answers to later requests."""

from __future__ import annotations

import os
import random
import time
import tty
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from semlive.errors import LinkError
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.registers import Kind
from semlive_drivers.modbus.rtu.frames import (
    build_frame,
    is_reply_to,
    parse_frame,
    read_request,
    replies_ambiguous,
    values_in,
    write_request,
)
from semlive_drivers.modbus.rtu.line import NoReply, RtuLine
from semlive_drivers.modbus.rtu.link import RtuLink
from semlive_drivers.serial_port import SerialSettings

from ...waiting import wait_until
from .emulated import Device, over_rtu

TIMEOUT_S = 0.4
"""Long compared with the time that a busy computer takes for an answer that is not late."""


class Lateness:
    """How late the next answers are, in turn; then none is."""

    def __init__(self) -> None:
        self.planned: list[float] = []

    def __call__(self) -> float:
        return self.planned.pop(0) if self.planned else 0.0


@pytest.fixture
def lateness() -> Lateness:
    return Lateness()


@pytest.fixture
def device() -> Device:
    return Device({address: 1000 + address for address in range(40)})


@pytest.fixture
def opened(device: Device, lateness: Lateness) -> Iterator[Callable[[], RtuLink]]:
    with over_rtu({1: device}, lateness) as path:
        lines = []

        def open_link() -> RtuLink:
            lines.append(RtuLine(SerialSettings(port=path, baud=115_200, slowest_s=1.4), TIMEOUT_S))
            return RtuLink(lines[-1], 1, (Block(Kind.HOLDING, 0, 4),))

        yield open_link
        for line in lines:
            line.close()


def test_a_late_answer_is_not_taken_for_the_next_one(opened: Callable[[], RtuLink], lateness: Lateness) -> None:
    link = opened()
    lateness.planned = [0.8]
    with pytest.raises(NoReply, match=r"unit 1 gave no answer within 0\.4 s while reading holding register 10; check cable"):
        link.read(Block(Kind.HOLDING, 10, 1))
    with pytest.raises(NoReply, match="an earlier answer is still pending"):
        link.read(Block(Kind.HOLDING, 11, 1))
    wait_until(link.resync)
    assert link.read(Block(Kind.HOLDING, 11, 1)) == (1011,)


def test_line_state_survives_closing_and_reopening(opened: Callable[[], RtuLink], lateness: Lateness) -> None:
    link = opened()
    lateness.planned = [0.8]
    with pytest.raises(NoReply):
        link.read(Block(Kind.HOLDING, 10, 4))
    link.close()
    again = opened()
    assert again.read(Block(Kind.HOLDING, 20, 4)) == (1020, 1021, 1022, 1023)


def test_a_silent_unit_is_probed_shortly_so_that_a_stop_does_not_wait(opened: Callable[[], RtuLink], lateness: Lateness) -> None:
    link = opened()
    lateness.planned = [5.0, 5.0]
    with pytest.raises(NoReply):
        link.read(Block(Kind.HOLDING, 10, 2))
    start_s = time.monotonic()
    assert not link.resync()
    assert time.monotonic() - start_s < 0.9 * TIMEOUT_S


def test_late_answers_to_the_probes_themselves(opened: Callable[[], RtuLink], lateness: Lateness) -> None:
    link = opened()
    lateness.planned = [0.6, 0.6, 0.6]
    with pytest.raises(NoReply):
        link.read(Block(Kind.HOLDING, 10, 2))
    assert not link.resync()
    wait_until(link.resync)
    assert [link.read(Block(Kind.HOLDING, 10 + n, 1 + n % 4)) for n in range(8)] == [
        tuple(range(1010 + n, 1011 + n + n % 4)) for n in range(8)
    ]


def test_a_stop_is_reported_on_an_unreliable_line_and_sent_first_after_reopening(
    opened: Callable[[], RtuLink], lateness: Lateness, device: Device
) -> None:
    link = opened()
    lateness.planned = [0.8]
    with pytest.raises(NoReply):
        link.read(Block(Kind.HOLDING, 10, 4))
    assert link.write_without_reply([write_request(Kind.HOLDING, 5, [2], False)])
    link.close()
    again = opened()
    assert [int.from_bytes(pdu[6:]) for pdu in device.writes] == [2, 2]
    again.write(5, [2])
    again.close()
    opened()
    assert len(device.writes) == 3


def test_a_stop_does_not_hang_on_a_line_that_takes_no_bytes() -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    line = RtuLine(SerialSettings(port=os.ttyname(theirs), baud=115_200, slowest_s=0.05), 0.1)
    took_s = []

    def shout() -> None:
        began_s = time.monotonic()
        try:
            line.broadcast(9, [write_request(Kind.HOLDING, 5, [0] * 100, False)])
        finally:
            took_s.append(time.monotonic() - began_s)

    with pytest.raises(LinkError, match="is gone"):
        wait_until(shout)
    assert max(took_s) < 1.5
    line.close()
    os.close(ours)
    os.close(theirs)


def test_writes_and_refusals(opened: Callable[[], RtuLink], device: Device) -> None:
    link = opened()
    link.write(3, [7, 8])
    link.write(5, [9], single=True)
    assert link.read(Block(Kind.HOLDING, 3, 3)) == (7, 8, 9)
    assert [pdu[0] for pdu in device.writes] == [16, 6]
    with pytest.raises(LinkError, match=r"refused reading input register 90: there is no such register \(exception 2\)"):
        link.read(Block(Kind.INPUT, 90, 1))
    with pytest.raises(LinkError, match="the function is not supported"):
        link.read(Block(Kind.COIL, 0, 3))


def test_a_silence_before_every_request(device: Device) -> None:
    with over_rtu({1: device}) as path:
        line = RtuLine(SerialSettings(port=path, baud=115_200, slowest_s=0.05, silence_s=0.03), TIMEOUT_S)
        link = RtuLink(line, 1, ())
        began_s = time.monotonic()
        for _ in range(5):
            link.read(Block(Kind.HOLDING, 0, 1))
        assert time.monotonic() - began_s > 4 * 0.03
        link.close()
        with pytest.raises(LinkError, match=r"the serial line .* is gone"):
            link.read(Block(Kind.HOLDING, 0, 1))


def test_three_hundred_readings_with_late_answers_are_right_or_refused(device: Device) -> None:
    chance = random.Random(7)
    with over_rtu({1: device}, lambda: chance.choice((0.0,) * 24 + (0.07,))) as path:
        link = RtuLink(RtuLine(SerialSettings(port=path, baud=115_200, slowest_s=0.3), 0.05), 1, (Block(Kind.HOLDING, 0, 4),))
        late = 0
        for _ in range(300):
            block = Block(Kind.HOLDING, chance.randrange(36), chance.randrange(1, 4))
            try:
                assert link.read(block) == tuple(range(1000 + block.address, 1000 + block.address + block.count))
            except NoReply:
                late += 1
                wait_until(link.resync)
        link.close()
    assert late > 5


@given(st.sampled_from(list(Kind)), st.integers(0, 65_000), st.integers(1, 120))
def test_a_reading_is_answered_by_its_own_length_only(kind: Kind, address: int, count: int) -> None:
    request = read_request(Block(kind, address, count))
    size = (count + 7) // 8 if kind.bits else 2 * count
    reply = bytes([request[0], size]) + bytes(size)
    assert is_reply_to(reply, request)
    assert is_reply_to(bytes([request[0] | 0x80, 2]), request)
    assert not is_reply_to(reply[:-1], request)
    other = read_request(Block(kind, address + 1, count))
    assert replies_ambiguous(request, other)
    assert len(values_in(reply, Block(kind, address, count))) == count
    assert parse_frame(build_frame(1, reply) + b"more").rest == b"more"


@given(st.binary(max_size=300))
def test_any_bytes_can_be_received(received: bytes) -> None:
    part = parse_frame(received)
    assert part.frame is None or part.frame + part.rest == received
    assert len(part.rest) <= len(received)


def test_requests_are_those_of_the_specification() -> None:
    assert build_frame(1, read_request(Block(Kind.HOLDING, 0, 10))) == bytes.fromhex("01030000000ac5cd")
    assert write_request(Kind.HOLDING, 1, [10, 258], False) == bytes.fromhex("100001000204000a0102")
    assert write_request(Kind.HOLDING, 1, [3], True) == bytes.fromhex("0600010003")
    assert write_request(Kind.COIL, 0x13, [1, 0, 1, 1, 0, 0, 1, 1, 1, 0], False) == bytes.fromhex("0f0013000a02cd01")
    assert write_request(Kind.COIL, 0xAC, [1], True) == bytes.fromhex("0500acff00")
