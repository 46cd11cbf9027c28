"""What a Modbus TCP device sends to one read request: for a device whose replies the driver cannot use. Nothing is written to it."""

from __future__ import annotations

import socket
import struct
import time

from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.rtu.frames import read_request
from semlive_drivers.modbus.tcp.blind import framed

_TRANSACTION = 0x5E31
_HEADER_BYTES = 7
_EXCEPTION_FLAG = 0x80
_MIN_WAIT_S = 2.0
"""A slow device may need longer than the time-out that it was given."""
_CONNECT_S = 1.0


def describe_answer(host: str, port: int, unit: int, block: Block, timeout_s: float) -> str | None:
    """What is wrong with the reply to a read request.

    Args:
        host: host name or address.
        port: TCP port.
        unit: Modbus unit that is addressed.
        block: registers to read.
        timeout_s: time-out of the driver, s; the wait is longer.

    Returns:
        The difference with its remedy, or None if nothing is received.
    """
    request = read_request(block)
    begin_s = time.monotonic()
    try:
        with socket.create_connection((host, port), _CONNECT_S) as sock:
            sock.sendall(framed(_TRANSACTION, unit, request))
            received, ended = _receive(sock, begin_s + max(_MIN_WAIT_S, 4 * timeout_s))
    except OSError:
        return None
    waited_s = time.monotonic() - begin_s
    if not received:
        return (
            "the device closed the connection without an answer; check --unit, and who else is connected to the device" if ended else None
        )
    return _judge(received, request, unit, block, waited_s, timeout_s)


def _receive(sock: socket.socket, until_s: float) -> tuple[bytes, bool]:
    """All bytes of one reply, and whether the device closed the connection; stops at the length in the header."""
    received = b""
    while (remaining_s := until_s - time.monotonic()) > 0:
        sock.settimeout(remaining_s)
        try:
            data = sock.recv(512)
        except TimeoutError:
            break
        if not data:
            return received, True
        received += data
        if len(received) >= _HEADER_BYTES and len(received) >= 6 + int.from_bytes(received[4:6]):
            break
    return received, False


def _judge(received: bytes, request: bytes, unit: int, block: Block, waited_s: float, timeout_s: float) -> str:
    """What differs from the standard in a reply."""
    if len(received) < _HEADER_BYTES + 1:
        return (
            f"the device sent {len(received)} bytes, which are no Modbus TCP reply; check the port, and that the device speaks Modbus TCP"
        )
    transaction, protocol, length, answered = struct.unpack(">HHHB", received[:_HEADER_BYTES])
    if protocol:
        return "the device answered, but not in Modbus TCP; check the port, or a gateway that passes Modbus RTU frames through"
    if answered != unit:
        return f"the device answered, but as unit {answered}; check again with --unit {answered}"
    if transaction != _TRANSACTION:
        return (
            f"the device answered, but with transaction number {transaction} instead of that of the request, so that no reply can be "
            "assigned to its request; update its firmware, or connect it by its serial line"
        )
    pdu = received[_HEADER_BYTES:]
    if pdu[0] & ~_EXCEPTION_FLAG != request[0]:
        return f"the device answered, but with function code {pdu[0]} instead of {request[0]}; check its firmware and the gateway before it"
    if pdu[0] == request[0] and len(pdu) != (expected := 2 + (block.count + 7) // 8 if block.kind.bits else 2 + 2 * block.count):
        return f"the device answered, but with {len(pdu)} bytes instead of {expected}; check its firmware and the gateway before it"
    if pdu[0] == request[0] and pdu[1] != len(pdu) - 2:
        return (
            f"the reply of the device states {pdu[1]} bytes of values and has {len(pdu) - 2}; update its firmware, or use its serial line"
        )
    if len(received) < 6 + length:
        return f"the reply of the device ended after {len(received)} of {6 + length} bytes; check the network and the gateway before it"
    if waited_s > timeout_s:
        return f"the device answered after {waited_s:.1f} s; check again with --timeout-s {2 * waited_s:.1f}, and find out why it is slow"
    return "the device answered now; the network or the device loses replies: check cable, and who else is connected"
