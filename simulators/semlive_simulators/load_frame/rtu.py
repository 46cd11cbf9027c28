"""Modbus RTU: a gateway between a serial line and the TCP server of the bench, so that both have the same registers.

Frame: unit, function and data as in Modbus TCP, then a CRC-16, low byte first (Modbus over serial line V1.02, section 2.5).
A frame with a wrong CRC or for another unit has no reply, as at a real device; a write to unit 0 is executed without a reply.
Stage and beam shift answer as a separate unit too, like two devices on one pair of wires.
"""

from __future__ import annotations

import socket
import struct

UNIT_FOR_ALL = 0
STAGE_UNIT = 7
_STAGE_REGISTERS = (range(3), range(100, 107), range(400, 407))
_WRITES = (5, 6, 15, 16)
_TIMEOUT_S = 2.0


def crc16(data: bytes) -> bytes:
    """The CRC-16 of a frame, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return struct.pack("<H", crc)


class RtuGateway:
    """Converts RTU frames to requests of the TCP server at a port of this computer, and its answers to frames."""

    def __init__(self, port: int, unit: int) -> None:
        self._unit = unit
        self._transaction = 0
        self._link = socket.create_connection(("127.0.0.1", port), timeout=_TIMEOUT_S)

    @property
    def port(self) -> int:
        """Local port of the connection to the server."""
        return self._link.getsockname()[1]

    def answer(self, frame: bytes) -> bytes:
        """The reply to a frame; empty where a device does not reply."""
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
        """Close the connection to the server."""
        self._link.close()

    def _ask(self, request: bytes) -> bytes | None:
        self._transaction = (self._transaction + 1) & 0xFFFF
        try:
            self._link.sendall(struct.pack(">HHHB", self._transaction, 0, len(request) + 1, self._unit) + request)
            _, _, length, _ = struct.unpack(">HHHB", self._receive(7))
            return self._receive(length - 1)
        except OSError:  # the bench is ending
            return None

    def _receive(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            chunk = self._link.recv(count - len(data))
            if not chunk:
                raise ConnectionResetError
            data += chunk
        return data


def _is_for_stage(request: bytes) -> bool:
    """Whether all registers of a request belong to the stage or to the identity."""
    if len(request) < 5:
        return False
    first, count = struct.unpack(">HH", request[1:5])
    last = first + (0 if request[0] in (5, 6) else count - 1)
    return any(first in block and last in block for block in _STAGE_REGISTERS)
