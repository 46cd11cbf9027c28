"""A Modbus TCP link to one unit, with pymodbus.

After any failure the link takes no more requests: the owner opens a new one, identity check included. Only a stop is still written on the
old connection, without waiting for an answer (`semlive_drivers.modbus.tcp.blind`). pymodbus would reconnect inside the next request,
without a check of the identity. Its retries are off, because they would extend the time to an answer to (retries + 1) times the timeout.
"""

from __future__ import annotations

import logging
import socket
from collections.abc import Callable, Sequence
from typing import Any

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from semlive.errors import LinkError, LinkRefused
from semlive_drivers.endpoint_lock import reserve_tcp
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.link import action_name, refusal
from semlive_drivers.modbus.registers import Kind
from semlive_drivers.modbus.tcp.blind import BlindWriter, add_pending_stop, clear_pending_stops, exchange, pending_stops

# Every failure becomes a LinkError; log lines of pymodbus on stderr would show the operator the same error twice.
logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)


class ModbusLink:
    """The Link over Modbus TCP.

    Args:
        host: host name or address.
        port: TCP port.
        unit: Modbus unit (device identifier).
        timeout_s: longest wait for one answer, wall time, s.

    Raises:
        LinkRefused: if the connection is not accepted, or another process uses this unit.
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
            raise LinkRefused(f"no device answers at {host}:{port}; check that the device is on and that host and port are right")
        self._key = (host, port, unit)
        try:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            # pymodbus closes its socket after any failure; the duplicate keeps the connection open for a last stop.
            self._blind = BlindWriter(sock.dup(), sock.getpeername(), unit)
        except OSError as error:
            self._client.close()
            self._endpoint.release()
            raise LinkRefused(f"{host}:{port} closed the connection at once ({error}); check who else uses the device") from error
        self._send_pending_stops(sock)

    def _send_pending_stops(self, sock: socket.socket) -> None:
        """Send the stops that were never answered; raises LinkRefused if they are not answered now."""
        pdus = pending_stops(self._key)
        if pdus and not exchange(sock, self._unit, pdus, self._timeout_s):
            self.close()
            raise LinkRefused(f"{self.where} did not answer the stop that was sent first within {self._timeout_s:g} s; check the device")
        clear_pending_stops(self._key)

    def read(self, block: Block) -> tuple[int, ...]:
        """Read the registers of a block, as `Link.read`.

        Raises:
            LinkError: if the answer is missing, wrong or short.
        """
        function, call = {
            Kind.INPUT: (4, self._client.read_input_registers),
            Kind.HOLDING: (3, self._client.read_holding_registers),
            Kind.COIL: (1, self._client.read_coils),
            Kind.DISCRETE: (2, self._client.read_discrete_inputs),
        }[block.kind]
        answer = self._ask(action_name("reading", block.kind, block.address), function, call, block.address, count=block.count)
        values = [int(bit) for bit in answer.bits[: block.count]] if block.kind.bits else answer.registers
        if len(values) != block.count:
            self._client.close()
            raise LinkError(
                f"{self.where} answered {len(values)} registers instead of {block.count} from {block.address}; "
                "check the device and the network"
            )
        return tuple(values)

    def write(self, address: int, registers: Sequence[int], kind: Kind = Kind.HOLDING, *, single: bool = False) -> None:
        """Write registers in one request (FC16, FC15; FC06, FC05 with `single`), as `Link.write`.

        Raises:
            LinkError: if the answer is missing or wrong.
        """
        action = action_name("writing", kind, address)
        if kind.bits and single:
            self._ask(action, 5, self._client.write_coil, address, bool(registers[0]))
        elif kind.bits:
            self._ask(action, 15, self._client.write_coils, address, [bool(value) for value in registers])
        elif single and len(registers) == 1:
            self._ask(action, 6, self._client.write_register, address, registers[0])
        else:
            self._ask(action, 16, self._client.write_registers, address, list(registers))

    def write_without_reply(self, pdus: Sequence[bytes]) -> bool:
        """Write on the old connection and on a new one, as `Link.write_without_reply`."""
        self._client.close()
        add_pending_stop(self._key, pdus)
        return self._blind.write(pdus)

    def resync(self) -> bool:
        """False: after a failure a new connection is necessary."""
        return False

    def close(self) -> None:
        """Close the connection; further requests fail at once."""
        self._client.close()
        self._blind.close()
        self._endpoint.release()

    def _ask(self, action: str, function: int, call: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Send a request; pymodbus accepts an answer of another function."""
        if not self._client.connected:
            raise LinkError(f"the link to {self.where} is closed; it must be opened again")
        try:
            answer = call(*args, device_id=self._unit, **kwargs)
        except (ModbusException, OSError) as error:
            self._client.close()
            raise LinkError(f"{self.where} gave no answer within {self._timeout_s:g} s while {action}; check cable and device") from error
        if answer.isError():
            raise refusal(self.where, action, int(getattr(answer, "exception_code", 0)))
        if answer.function_code != function:
            self._client.close()
            raise LinkError(
                f"{self.where} answered function {answer.function_code} instead of {function} while {action}; "
                "check the device and the gateway before it"
            )
        return answer
