"""`semlive frame check` on devices that answer late, busy, as another unit, or through a gateway."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from semlive.data.checks import FrameCheck, Verdict
from semlive.errors import LinkRefused
from semlive_drivers.modbus.check import check_modbus

WORDS = dict(enumerate(struct.unpack(">4H", struct.pack(">ff", 123.456, 1.2345))))
Reply = Callable[[int, int, int, bytes, list[bytes]], bytes]
"""From transaction, unit, number of the request on this connection, PDU and earlier replies, what is sent."""


def framed(transaction: int, unit: int, pdu: bytes) -> bytes:
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


def right(pdu: bytes) -> bytes:
    """The answer of the device to a request; holding registers are 0."""
    address, count = struct.unpack(">HH", pdu[1:5])
    words = [WORDS.get(address + place, 0) if pdu[0] == 4 else 0 for place in range(count)]
    return bytes([pdu[0], 2 * count]) + struct.pack(f">{count}H", *words)


@contextmanager
def device(reply: Reply) -> Iterator[int]:
    """Serve; gives the port."""

    def serve(client: socket.socket) -> None:
        sent: list[bytes] = []
        # The other side resets its connection if it closes it before it has read a late answer.
        with contextlib.suppress(OSError), client, client.makefile("rb") as stream:
            while len(head := stream.read(7)) == 7:
                transaction, _, length, unit = struct.unpack(">HHHB", head)
                sent.append(reply(transaction, unit, len(sent), stream.read(length - 1), sent))
                client.sendall(sent[-1])

    def accept(listening: socket.socket) -> None:
        while True:
            try:
                client, _ = listening.accept()
            except OSError:
                return
            threading.Thread(target=serve, args=(client,), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=accept, args=(listening,), daemon=True).start()
        yield listening.getsockname()[1]


def checked(reply: Reply) -> FrameCheck:
    with device(reply) as port:
        return check_modbus("generic", {"port": port, "timeout_s": 0.4})


@pytest.mark.parametrize(("code", "advice"), [(10, "routing table of the gateway"), (11, "serial side of the gateway"), (4, "alarm")])
def test_an_exception_for_every_register_is_one_finding(code: int, advice: str) -> None:
    found = checked(lambda transaction, unit, number, pdu, sent: framed(transaction, unit, bytes([pdu[0] | 0x80, code])))
    (refused,) = [finding for finding in found.findings if f"(exception {code})" in finding.observation]
    assert refused.what.startswith("force, extension, motion")
    assert advice in refused.advice
    assert not any("order" in finding.what or "scale" in finding.what for finding in found.findings)
    assert not found.passed


def test_a_device_that_is_busy_once_is_read_again() -> None:
    def reply(transaction: int, unit: int, number: int, pdu: bytes, sent: list[bytes]) -> bytes:
        return framed(transaction, unit, bytes([pdu[0] | 0x80, 6]) if number == 0 else right(pdu))

    assert all(finding.verdict is not Verdict.FAILED for finding in checked(reply).findings)


def test_a_device_that_serves_holding_registers_only() -> None:
    def reply(transaction: int, unit: int, number: int, pdu: bytes, sent: list[bytes]) -> bytes:
        return framed(transaction, unit, bytes([0x84, 1]) if pdu[0] == 4 else bytes([3]) + right(b"\x04" + pdu[1:])[1:])

    found = {finding.what: finding for finding in checked(reply).findings}
    assert "use the other kind of force, extension and motion" in found["force, extension, motion"].advice
    assert "holding register instead of input register" in found["order of words"].observation


def test_after_a_late_reply_the_link_is_opened_again() -> None:
    def late(transaction: int, unit: int, number: int, pdu: bytes, sent: list[bytes]) -> bytes:
        return sent[-1] if sent else framed(transaction, unit, right(pdu))

    found = {finding.what: finding for finding in checked(late).findings}
    assert found["force"].observation.startswith("123.456 ")
    assert found["extension"].observation.startswith("1.2345 ")
    assert "the link was opened again" in found["lost replies"].advice


@pytest.mark.parametrize(
    ("reply", "sentence"),
    [
        (lambda t, u, n, pdu, s: framed(t, 255, right(pdu)), "answered, but as unit 255; check again with --unit 255"),
        (lambda t, u, n, pdu, s: framed(t, 0, right(pdu)), "answered, but as unit 0; check again with --unit 0"),
        (lambda t, u, n, pdu, s: framed(0, u, right(pdu)), "with transaction number 0 instead of that of the request"),
        (lambda t, u, n, pdu, s: framed(t, u, right(pdu)[:-2]), "answered, but with 4 bytes instead of 6"),
        (lambda t, u, n, pdu, s: framed(t, u, b"\3" + right(pdu)[1:]), "answered, but with function code 3 instead of 4"),
        (lambda t, u, n, pdu, s: framed(t, u, right(pdu)[:1] + b"\2" + right(pdu)[2:]), "states 2 bytes of values and has 4"),
        (lambda t, u, n, pdu, s: b"HTTP/1.1 400 Bad Request\r\n\r\n", "answered, but not in Modbus TCP"),
    ],
    ids=["unit 255", "unit 0", "transaction 0", "short", "function", "count of bytes", "web server"],
)
def test_an_answer_that_is_of_no_use_is_named(reply: Reply, sentence: str) -> None:
    with pytest.raises(LinkRefused, match=sentence):
        checked(reply)


def test_holding_registers_from_40001_of_a_device_that_has_no_others() -> None:
    def reply(transaction: int, unit: int, number: int, pdu: bytes, sent: list[bytes]) -> bytes:
        address, count = struct.unpack(">HH", pdu[1:5])
        is_there = pdu[0] == 3 and address >= 40_001 and address + count <= 40_005
        return framed(
            transaction, unit, b"\3" + right(struct.pack(">BHH", 4, address - 40_001, count))[1:] if is_there else bytes([pdu[0] | 0x80, 2])
        )

    found = {finding.what: finding for finding in checked(reply).findings}
    assert "address + 40001, holding register instead of input register" in found["order of words"].observation
    assert "force 123.456 N" in found["explanation 1"].observation
