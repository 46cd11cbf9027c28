"""Modbus RTU frames without IO: request and reply as bytes, and whether a reply matches a request.

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
_EXCEPTION_FLAG = 0x80
_MIN_FRAME_BYTES = 4
_EXCEPTION_BYTES = 5


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
    """The CRC-16 of a frame, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return struct.pack("<H", crc)


def build_frame(unit: int, pdu: bytes) -> bytes:
    """A frame: unit, PDU and CRC."""
    body = bytes([unit]) + pdu
    return body + crc16(body)


def read_request(block: Block) -> bytes:
    """The request for a block (FC01 to 04)."""
    return struct.pack(">BHH", _READ[block.kind], block.address, block.count)


def write_request(kind: Kind, address: int, values: Sequence[int], single: bool) -> bytes:
    """The request that writes registers (FC16, or FC06 with `single`) or coils (FC15, or FC05 with `single`)."""
    if kind.bits:
        if single and len(values) == 1:
            return struct.pack(">BHH", 5, address, 0xFF00 if values[0] else 0)
        packed = sum(bool(value) << index for index, value in enumerate(values)).to_bytes((len(values) + 7) // 8, "little")
        return struct.pack(">BHHB", 15, address, len(values), len(packed)) + packed
    if single and len(values) == 1:
        return struct.pack(">BHH", 6, address, values[0])
    return struct.pack(f">BHHB{len(values)}H", 16, address, len(values), 2 * len(values), *values)


def values_in(pdu: bytes, block: Block) -> tuple[int, ...]:
    """The registers (or bits, each 0 or 1) in the answer to the request for a block."""
    if block.kind.bits:
        return tuple(pdu[2 + index // 8] >> index % 8 & 1 for index in range(block.count))
    return struct.unpack(f">{block.count}H", pdu[2:])


def is_reply_to(reply: bytes, request: bytes) -> bool:
    """Whether function and length of a reply match a request (both without unit and CRC); an exception matches."""
    if reply[0] == request[0] | _EXCEPTION_FLAG:
        return len(reply) == 2
    if reply[0] != request[0]:
        return False
    if reply[0] in _ECHOED:
        return reply[:5] == request[:5]
    (count,) = struct.unpack(">H", request[3:5])
    return len(reply) == 2 + reply[1] and reply[1] == (2 * count if reply[0] > 2 else (count + 7) // 8)


def replies_ambiguous(first: bytes, second: bytes) -> bool:
    """Whether the answers to two requests cannot be distinguished by function and length."""
    if first[0] != second[0]:
        return False
    return first[:5] == second[:5] if first[0] in _ECHOED else first[3:5] == second[3:5]


@dataclass(frozen=True, slots=True)
class ParsedFrame:
    """The first frame in received bytes.

    Attributes:
        frame: a complete frame with a correct CRC, or None.
        rest: bytes after it.
        broken: whether the bytes are not the beginning of a frame.
    """

    frame: bytes | None
    rest: bytes
    broken: bool = False


def parse_frame(received: bytes) -> ParsedFrame:
    """The first frame in received bytes, by the length in its header; no frame while bytes are missing."""
    if len(received) < 3:
        return ParsedFrame(None, received)
    function = received[1]
    if function & _EXCEPTION_FLAG:
        length = _EXCEPTION_BYTES
    elif 1 <= function <= 4:
        length = 5 + received[2]
    elif function in _ECHOED:
        length = 8
    else:
        return ParsedFrame(None, received, broken=True)
    if len(received) < length:
        return ParsedFrame(None, received)
    frame, rest = received[:length], received[length:]
    if len(frame) < _MIN_FRAME_BYTES or crc16(frame[:-2]) != frame[-2:]:
        return ParsedFrame(None, received, broken=True)
    return ParsedFrame(frame, rest)
