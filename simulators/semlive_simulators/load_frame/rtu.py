"""Modbus RTU: a gateway between a serial line and the bench's TCP server, so that both speak of the same registers.

Frame: unit, function and data as in Modbus TCP, then a CRC-16, low byte first (Modbus over serial line V1.02, section 2.5).
A frame with a wrong CRC or for another unit meets silence, as at a real device; a write to unit 0 acts without a reply.
The stage and the beam's shift answer as a unit of their own too, as two devices on one pair of wires do.
"""

from __future__ import annotations

import socket
import struct

UNIT_FOR_ALL = 0
STAGE_UNIT = 7
_OF_STAGE = (range(3), range(100, 107), range(400, 407))
_WRITES = (5, 6, 15, 16)
_TIMEOUT_S = 2.0


def crc16(data: bytes) -> bytes:
    """The check bytes of a frame."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return struct.pack("<H", crc)


class RtuGateway:
    """Turns RTU frames into requests of the TCP server at a port of this machine, and its answers into frames."""

    def __init__(self, port: int, unit: int) -> None:
        self._unit = unit
        self._number = 0
        self._link = socket.create_connection(("127.0.0.1", port), timeout=_TIMEOUT_S)

    @property
    def port(self) -> int:
        """Its own end of the link to the server."""
        return self._link.getsockname()[1]

    def answer(self, frame: bytes) -> bytes:
        """The reply to a frame; empty where a device keeps silent."""
        if len(frame) < 4 or crc16(frame[:-2]) != frame[-2:]:
            return b""
        unit, request = frame[0], frame[1:-2]
        if unit == UNIT_FOR_ALL and request[0] in _WRITES:
            self._ask(request)
            return b""
        if unit not in (self._unit, STAGE_UNIT):
            return b""
        reply = self._ask(request) if unit == self._unit or _is_for_stage(request) else bytes([request[0] | 0x80, 2])
        return b"" if reply is None else bytes([unit]) + reply + crc16(bytes([unit]) + reply)

    def close(self) -> None:
        """Leave the server."""
        self._link.close()

    def _ask(self, request: bytes) -> bytes | None:
        self._number = (self._number + 1) & 0xFFFF
        try:
            self._link.sendall(struct.pack(">HHHB", self._number, 0, len(request) + 1, self._unit) + request)
            _, _, length, _ = struct.unpack(">HHHB", self._received(7))
            return self._received(length - 1)
        except OSError:  # the bench is ending
            return None

    def _received(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            more = self._link.recv(count - len(data))
            if not more:
                raise ConnectionResetError
            data += more
        return data


def _is_for_stage(request: bytes) -> bool:
    """Whether all registers of a request belong to the stage, or tell who answers."""
    if len(request) < 5:
        return False
    first, count = struct.unpack(">HH", request[1:5])
    last = first + (0 if request[0] in (5, 6) else count - 1)
    return any(first in block and last in block for block in _OF_STAGE)
