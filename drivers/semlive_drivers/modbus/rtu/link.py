"""A Modbus RTU link to one unit on a serial line that other units may share."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from semlive.errors import LinkError, SemliveError
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.link import action_name, refusal
from semlive_drivers.modbus.registers import Kind
from semlive_drivers.modbus.rtu.frames import read_request, values_in, write_request
from semlive_drivers.modbus.rtu.line import RtuLine
from semlive_drivers.modbus.rtu.shared_line import LineClient

_PROBE_S = 0.15
"""Longest wait for the answer to the probe after a lost answer, s. With the default `timeout_s` of 0.3 s and a reading every 0.05 s, the
stop order on a lost link is written within 0.55 s, which is less than `limits.stale_after_s` and 0.1 s."""


class RtuLink:
    """The Link over a serial line that other units may share.

    Args:
        line: open, owned by the same thread; or a client of a shared line.
        unit: Modbus unit.
        probes: blocks that can be read without side effects, to assign answers again after a failure.
        reopen: opens the line again for a stop that cannot be written on `line`; None does not.

    Raises:
        LinkError: if an answer to an earlier request is pending and the unit does not answer the probe.
    """

    def __init__(
        self, line: RtuLine | LineClient, unit: int, probes: Sequence[Block], reopen: Callable[[], RtuLine | LineClient] | None = None
    ) -> None:
        self._reopen = reopen
        self.where = f"{line.where} unit {unit}"
        self._line, self._unit, self._probes = line, unit, tuple(probes)
        if isinstance(line, LineClient):
            line.send_urgent(unit)
        if line.has_pending_reply(unit):
            line.drain(unit, self._probes)

    def read(self, block: Block) -> tuple[int, ...]:
        """Read the registers of a block, as `Link.read`.

        Raises:
            LinkError: if the answer is missing or wrong.
        """
        return values_in(self._ask(read_request(block), action_name("reading", block.kind, block.address)), block)

    def write(self, address: int, registers: Sequence[int], kind: Kind = Kind.HOLDING, *, single: bool = False) -> None:
        """Write registers in one request, as `Link.write`.

        Raises:
            LinkError: if the answer is missing or wrong.
        """
        self._ask(write_request(kind, address, registers, single), action_name("writing", kind, address))

    def write_without_reply(self, pdus: Sequence[bytes]) -> bool:
        """Write on the line, which is opened again if it is closed, as `Link.write_without_reply`."""
        try:
            self._line.broadcast(self._unit, pdus)
            return True
        except LinkError:
            if self._reopen is None:
                return False
        try:
            line = self._reopen()
        except SemliveError:
            return False
        try:
            line.broadcast(self._unit, pdus)
        except LinkError:
            return False
        finally:
            line.close()
        return True

    def resync(self) -> bool:
        """Probe the unit once, for at most `_PROBE_S`; False if it does not answer. A stop on a lost link waits for this probe."""
        try:
            self._line.drain(self._unit, self._probes, patient=False, wait_s=_PROBE_S)
        except LinkError:
            return False
        return True

    def close(self) -> None:
        """Close the line; a shared line stays open for its other clients."""
        self._line.close()

    def _ask(self, pdu: bytes, action: str) -> bytes:
        reply = self._line.transact(self._unit, pdu, action)
        if reply[0] != pdu[0]:
            raise refusal(self.where, action, reply[1])
        return reply
