"""Modbus links to one unit: over TCP a thin door to pymodbus, over a serial line our own master. All that goes wrong is a LinkError.

After any trouble a TCP link takes no more requests: the owner opens a new one, identity check included; only a stop is still written on
the old connection, without waiting for an answer (`semlive_drivers.modbus.blind`). pymodbus would reconnect by itself inside the next
request, to whoever answers then. Its own retries are off, because a request that is repeated behind our back makes the time to an answer
(retries + 1) times the timeout.
"""

from __future__ import annotations

import logging
import socket
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from semlive.errors import LinkError, LinkRefused, SemliveError
from semlive_drivers.endpoint_lock import reserve_tcp
from semlive_drivers.modbus.blind import BlindWriter, exchange, owe, owed, settle
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.registers import Kind
from semlive_drivers.modbus.rtu.frames import read_request, values_in, write_request
from semlive_drivers.modbus.rtu.line import RtuLine
from semlive_drivers.modbus.rtu.shared_line import LineClient

# Every failure becomes a LinkError; pymodbus's own lines on stderr would tell the operator the same thing twice.
logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)

_EXCEPTIONS = {
    1: "the function is not supported (exception 1)",
    2: "there is no such register (exception 2); check the register map",
    3: "the value is not allowed (exception 3)",
    4: "the device failed (exception 4); check the unit number and the device",
    5: "the device needs longer (exception 5)",
    6: "the device is busy (exception 6); try again when it has finished",
    7: "the device's watchdog has expired (exception 7)",
}
_PROBE_S = 0.15
"""Longest wait for the answer to the probe after a lost answer, s. With the default `timeout_s` of 0.3 s and a reading every 0.05 s, the
stop order on a lost link is written within 0.55 s, which is less than `limits.stale_after_s` and 0.1 s."""
_WORDS = {Kind.INPUT: "input register", Kind.HOLDING: "holding register", Kind.COIL: "coil", Kind.DISCRETE: "discrete input"}


class Refused(LinkError):
    """The device answered a request with an exception.

    Args:
        sentence: for a person.
        code: of the exception.
    """

    def __init__(self, sentence: str, code: int) -> None:
        super().__init__(sentence)
        self.code = code

    @property
    def is_final(self) -> bool:
        """The device will never answer this request otherwise: no such function, register or value."""
        return self.code in (1, 2, 3)


class Link(Protocol):
    """A connection to one unit. Not thread-safe: one thread owns it."""

    where: str

    def read(self, block: Block) -> tuple[int, ...]:
        """The registers of a block; raises LinkError on no, a wrong or a short answer."""
        ...

    def write(self, address: int, registers: Sequence[int], kind: Kind = Kind.HOLDING, *, single: bool = False) -> None:
        """Write in one request; raises LinkError on no or a wrong answer."""
        ...

    def write_without_reply(self, pdus: Sequence[bytes]) -> bool:
        """Write requests without waiting for an answer, also after a failure and after `close`; never raises.

        The link cannot be used for anything else afterwards. What was written is written first when the unit is opened again.

        Returns:
            Whether anything was written.
        """
        ...

    def resync(self) -> bool:
        """After a failed request: make the link believable again without opening another; False if that cannot be."""
        ...

    def close(self) -> None:
        """Close the connection; never raises."""
        ...


def write_verified(link: Link, block: Block, registers: Sequence[int], *, single: bool = False) -> None:
    """Write a block and read it back.

    Raises:
        LinkError: if the device did not take exactly this.
    """
    link.write(block.address, registers, block.kind, single=single)
    taken = link.read(block)
    if taken != tuple(registers):
        raise LinkError(
            f"{link.where} did not take the command: {list(registers)} was written from register {block.address}, "
            f"{list(taken)} was read back; check the device's limits and who else commands it"
        )


class ModbusLink:
    """The Link over Modbus TCP.

    Args:
        host: name or address.
        port: TCP port.
        unit: Modbus unit (device id).
        timeout_s: longest wait for one answer, wall time.

    Raises:
        LinkRefused: if nobody accepts the connection, or another process drives this unit.
    """

    def __init__(self, host: str, port: int, unit: int, timeout_s: float) -> None:
        self.where = f"{host}:{port} unit {unit}"
        self._endpoint = reserve_tcp(host, port, unit)
        self._unit = unit
        self._timeout_s = timeout_s
        self._client = ModbusTcpClient(host, port=port, timeout=timeout_s, retries=0, reconnect_delay_max=1.0, name=self.where)
        sock = self._client.socket if self._client.connect() else None
        if sock is None:
            self._endpoint.release()
            raise LinkRefused(f"nobody answers at {host}:{port}; check that the device is on and that host and port are right")
        self._key = (host, port, unit)
        try:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            # pymodbus closes its socket after any trouble; the connection behind it stays open for a last stop.
            self._blind = BlindWriter(sock.dup(), sock.getpeername(), unit)
        except OSError as error:
            self._client.close()
            self._endpoint.release()
            raise LinkRefused(f"{host}:{port} closed the connection at once ({error}); check who else uses the device") from error
        self._say_owed(sock)

    def _say_owed(self, sock: socket.socket) -> None:
        """Begin with the stops that were never answered; raises LinkRefused if they are not answered now."""
        pdus = owed(self._key)
        if pdus and not exchange(sock, self._unit, pdus, self._timeout_s):
            self.close()
            raise LinkRefused(f"{self.where} did not answer the stop that was sent first within {self._timeout_s:g} s; check the device")
        settle(self._key)

    def read(self, block: Block) -> tuple[int, ...]:
        """The registers of a block, as `Link.read`.

        Raises:
            LinkError: on no, a wrong or a short answer.
        """
        call = {
            Kind.INPUT: self._client.read_input_registers,
            Kind.HOLDING: self._client.read_holding_registers,
            Kind.COIL: self._client.read_coils,
            Kind.DISCRETE: self._client.read_discrete_inputs,
        }[block.kind]
        answer = self._ask(f"reading {_WORDS[block.kind]} {block.address}", call, block.address, count=block.count)
        values = [int(bit) for bit in answer.bits[: block.count]] if block.kind.bits else answer.registers
        if len(values) != block.count:
            self._client.close()
            raise LinkError(
                f"{self.where} answered {len(values)} registers instead of {block.count} from {block.address}; "
                "check the device and the network"
            )
        return tuple(values)

    def write(self, address: int, registers: Sequence[int], kind: Kind = Kind.HOLDING, *, single: bool = False) -> None:
        """Write in one request (FC16, FC15; FC06, FC05 for one by itself), as `Link.write`.

        Raises:
            LinkError: on no or a wrong answer.
        """
        doing = f"writing {_WORDS[kind]} {address}"
        if kind.bits and single:
            self._ask(doing, self._client.write_coil, address, bool(registers[0]))
        elif kind.bits:
            self._ask(doing, self._client.write_coils, address, [bool(value) for value in registers])
        elif single and len(registers) == 1:
            self._ask(doing, self._client.write_register, address, registers[0])
        else:
            self._ask(doing, self._client.write_registers, address, list(registers))

    def write_without_reply(self, pdus: Sequence[bytes]) -> bool:
        """Write on the old connection and on a fresh one, as `Link.write_without_reply`."""
        self._client.close()
        owe(self._key, pdus)
        return self._blind.write(pdus)

    def resync(self) -> bool:
        """Never: another socket is opened."""
        return False

    def close(self) -> None:
        """Close the connection; further requests fail at once."""
        self._client.close()
        self._blind.close()
        self._endpoint.release()

    def _ask(self, doing: str, call: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        if not self._client.connected:
            raise LinkError(f"the link to {self.where} is closed; it must be opened again")
        try:
            answer = call(*args, device_id=self._unit, **kwargs)
        except (ModbusException, OSError) as error:
            self._client.close()
            raise LinkError(f"{self.where} gave no answer within {self._timeout_s:g} s while {doing}; check cable and device") from error
        if answer.isError():
            raise _refusal(self.where, doing, int(getattr(answer, "exception_code", 0)))
        return answer


class RtuLink:
    """The Link over a serial line that other units may share.

    Args:
        line: open, owned by the same thread; or a share of one.
        unit: Modbus unit.
        probes: blocks that can be read without harm, to settle the line with after trouble.
        reopen: opens the line again for a stop that cannot be written otherwise.

    Raises:
        LinkError: if an answer is still owed from before and the unit does not settle.
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
        """The registers of a block, as `Link.read`.

        Raises:
            LinkError: on no or a wrong answer.
        """
        return values_in(self._ask(read_request(block), f"reading {_WORDS[block.kind]} {block.address}"), block)

    def write(self, address: int, registers: Sequence[int], kind: Kind = Kind.HOLDING, *, single: bool = False) -> None:
        """Write in one request, as `Link.write`.

        Raises:
            LinkError: on no or a wrong answer.
        """
        self._ask(write_request(kind, address, registers, single), f"writing {_WORDS[kind]} {address}")

    def write_without_reply(self, pdus: Sequence[bytes]) -> bool:
        """Write on the line, or on the line opened again where it is closed, as `Link.write_without_reply`."""
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
        """Settle the unit with one probe of at most `_PROBE_S`; False if it does not answer. A stop on a lost link waits for this probe."""
        try:
            self._line.drain(self._unit, self._probes, patient=False, wait_s=_PROBE_S)
        except LinkError:
            return False
        return True

    def close(self) -> None:
        """Close the line, or leave it to those who share it."""
        self._line.close()

    def _ask(self, pdu: bytes, doing: str) -> bytes:
        reply = self._line.transact(self._unit, pdu, doing)
        if reply[0] != pdu[0]:
            raise _refusal(self.where, doing, reply[1])
        return reply


def _refusal(where: str, doing: str, code: int) -> Refused:
    return Refused(f"{where} refused {doing}: {_EXCEPTIONS.get(code, f'exception {code}')}", code)
