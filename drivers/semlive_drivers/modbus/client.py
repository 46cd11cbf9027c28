"""One Modbus TCP link: a thin door to pymodbus that maps everything that can go wrong to LinkError.

After any trouble the socket is closed and stays closed: the owner opens a new link, identity check included. pymodbus would
reconnect by itself inside the next request, to whoever answers then. Its own retries are off, because a request that is repeated
behind our back makes the time to an answer (retries + 1) times the timeout.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from semlive.errors import LinkError, LinkRefused
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.registers import Kind

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


class ModbusLink:
    """A connection to one unit. Not thread-safe: one thread owns it.

    Args:
        host: name or address.
        port: TCP port.
        unit: Modbus unit (device id).
        timeout_s: longest wait for one answer, wall time.

    Raises:
        LinkRefused: if nobody accepts the connection.
    """

    def __init__(self, host: str, port: int, unit: int, timeout_s: float) -> None:
        self.where = f"{host}:{port} unit {unit}"
        self._unit = unit
        self._timeout_s = timeout_s
        self._client = ModbusTcpClient(host, port=port, timeout=timeout_s, retries=0, reconnect_delay_max=1.0, name=self.where)
        if not self._client.connect():
            raise LinkRefused(f"nobody answers at {host}:{port}; check that the device is on and that host and port are right")

    def read(self, block: Block) -> tuple[int, ...]:
        """The registers of a block.

        Raises:
            LinkError: on no, a wrong or a short answer.
        """
        call = self._client.read_input_registers if block.kind is Kind.INPUT else self._client.read_holding_registers
        answer = self._ask(f"reading {block.kind} register {block.address}", call, block.address, count=block.count)
        if len(answer.registers) != block.count:
            self.close()
            raise LinkError(
                f"{self.where} answered {len(answer.registers)} registers instead of {block.count} from {block.address}; "
                "check the device and the network"
            )
        return tuple(answer.registers)

    def write(self, address: int, registers: Sequence[int]) -> None:
        """Write holding registers in one request (FC16).

        Raises:
            LinkError: on no or a wrong answer.
        """
        self._ask(f"writing holding register {address}", self._client.write_registers, address, list(registers))

    def write_verified(self, block: Block, registers: Sequence[int]) -> None:
        """Write a block and read it back.

        Raises:
            LinkError: if the device did not take exactly this.
        """
        self.write(block.address, registers)
        taken = self.read(block)
        if taken != tuple(registers):
            raise LinkError(
                f"{self.where} did not take the command: {list(registers)} was written from register {block.address}, "
                f"{list(taken)} was read back; check the device's limits and who else commands it"
            )

    def close(self) -> None:
        """Close the socket; further calls fail at once."""
        self._client.close()

    def _ask(self, doing: str, call: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        if not self._client.connected:
            raise LinkError(f"the link to {self.where} is closed; it must be opened again")
        try:
            answer = call(*args, device_id=self._unit, **kwargs)
        except (ModbusException, OSError) as error:
            self.close()
            raise LinkError(f"{self.where} gave no answer within {self._timeout_s:g} s while {doing}; check cable and device") from error
        if answer.isError():
            code = int(getattr(answer, "exception_code", 0))
            raise LinkError(f"{self.where} refused {doing}: {_EXCEPTIONS.get(code, f'exception {code}')}")
        return answer
