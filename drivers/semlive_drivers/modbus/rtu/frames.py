"""Modbus RTU frames without IO: request and reply as bytes, and whether a reply can be the answer to a request.

Modbus over serial line V1.02, section 2.5; Modbus application protocol V1.1b3, section 6.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.registers import Kind

_READ = {Kind.COIL: 1, Kind.DISCRETE: 2, Kind.HOLDING: 3, Kind.INPUT: 4}
_ECHOED = (5, 6, 8, 15, 16)
_REFUSED = 0x80
_SHORTEST = 4
_EXCEPTION = 5


def _table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
        table.append(crc)
    return tuple(table)


_TABLE = _table()


def crc16(data: bytes) -> bytes:
    """The check bytes of a frame, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return struct.pack("<H", crc)


def build_frame(unit: int, pdu: bytes) -> bytes:
    """A frame on the line."""
    body = bytes([unit]) + pdu
    return body + crc16(body)


def read_request(block: Block) -> bytes:
    """The request for a block (FC01 to 04)."""
    return struct.pack(">BHH", _READ[block.kind], block.address, block.count)


def write_request(kind: Kind, address: int, values: Sequence[int], single: bool) -> bytes:
    """The request that writes registers (FC16, or FC06 for one by itself) or coils (FC15, FC05)."""
    if kind.bits:
        if single and len(values) == 1:
            return struct.pack(">BHH", 5, address, 0xFF00 if values[0] else 0)
        packed = sum(bool(value) << place for place, value in enumerate(values)).to_bytes((len(values) + 7) // 8, "little")
        return struct.pack(">BHHB", 15, address, len(values), len(packed)) + packed
    if single and len(values) == 1:
        return struct.pack(">BHH", 6, address, values[0])
    return struct.pack(f">BHHB{len(values)}H", 16, address, len(values), 2 * len(values), *values)


def values_in(pdu: bytes, block: Block) -> tuple[int, ...]:
    """The registers (or bits, each 0 or 1) of an answer to a reading of a block."""
    if block.kind.bits:
        return tuple(pdu[2 + place // 8] >> place % 8 & 1 for place in range(block.count))
    return struct.unpack(f">{block.count}H", pdu[2:])


def is_reply_to(reply: bytes, request: bytes) -> bool:
    """Whether a reply's form is that of the answer to a request (both without unit and check); a refusal is."""
    if reply[0] == request[0] | _REFUSED:
        return len(reply) == 2
    if reply[0] != request[0]:
        return False
    if reply[0] in _ECHOED:
        return reply[:5] == request[:5]
    (count,) = struct.unpack(">H", request[3:5])
    return len(reply) == 2 + reply[1] and reply[1] == (2 * count if reply[0] > 2 else (count + 7) // 8)


def replies_ambiguous(one: bytes, other: bytes) -> bool:
    """Whether the answers to two requests could be taken for each other by their form."""
    if one[0] != other[0]:
        return False
    return one[:5] == other[:5] if one[0] in _ECHOED else one[3:5] == other[3:5]


@dataclass(frozen=True, slots=True)
class ParsedFrame:
    """What a stretch of received bytes begins with.

    Attributes:
        frame: a whole frame with a right check, or None.
        rest: what follows it.
        broken: what has come is no beginning of a frame.
    """

    frame: bytes | None
    rest: bytes
    broken: bool = False


def parse_frame(received: bytes) -> ParsedFrame:
    """The first frame of what was received, by the length that its own head says; nothing while more must come."""
    if len(received) < 3:
        return ParsedFrame(None, received)
    function = received[1]
    if function & _REFUSED:
        length = _EXCEPTION
    elif 1 <= function <= 4:
        length = 5 + received[2]
    elif function in _ECHOED:
        length = 8
    else:
        return ParsedFrame(None, received, broken=True)
    if len(received) < length:
        return ParsedFrame(None, received)
    frame, rest = received[:length], received[length:]
    if len(frame) < _SHORTEST or crc16(frame[:-2]) != frame[-2:]:
        return ParsedFrame(None, received, broken=True)
    return ParsedFrame(frame, rest)
