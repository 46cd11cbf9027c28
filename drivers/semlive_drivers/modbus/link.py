"""The link to one Modbus unit: what every transport offers, and its errors.

The transports are `semlive_drivers.modbus.tcp.link` and `semlive_drivers.modbus.rtu.link`. Every failure is a LinkError.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from semlive.errors import LinkError
from semlive_drivers.modbus.codec import Block
from semlive_drivers.modbus.registers import Kind

EXCEPTIONS = {
    1: "the function is not supported (exception 1)",
    2: "there is no such register (exception 2); check the register map",
    3: "the value is not allowed (exception 3)",
    4: "the device failed (exception 4); check the unit number and the device",
    5: "the device needs longer (exception 5)",
    6: "the device is busy (exception 6); try again when it has finished",
    7: "the device's watchdog has expired (exception 7)",
    8: "the device found an error in its memory (exception 8)",
    10: "the gateway has no path to this unit (exception 10)",
    11: "the device behind the gateway did not answer (exception 11)",
}
"""Meaning of each Modbus exception."""


class Refused(LinkError):
    """The device answered a request with an exception.

    Args:
        message: the text of the error.
        code: Modbus exception code.
    """

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code

    @property
    def is_final(self) -> bool:
        """Whether the device refuses this request permanently: there is no such function, register or value."""
        return self.code in (1, 2, 3)


class Link(Protocol):
    """A connection to one unit. Not thread-safe: one thread owns it."""

    where: str

    def read(self, block: Block) -> tuple[int, ...]:
        """Read the registers of a block; raises LinkError if the answer is missing, wrong or short."""
        ...

    def write(self, address: int, registers: Sequence[int], kind: Kind = Kind.HOLDING, *, single: bool = False) -> None:
        """Write registers in one request; raises LinkError if the answer is missing or wrong."""
        ...

    def write_without_reply(self, pdus: Sequence[bytes]) -> bool:
        """Write requests without waiting for an answer, also after a failure and after `close`; never raises.

        The link cannot be used for anything else afterwards. When the unit is opened again, the same requests are written first.

        Returns:
            Whether anything was written.
        """
        ...

    def resync(self) -> bool:
        """After a failed request, assign answers to requests again without opening another link; False if that is not possible."""
        ...

    def close(self) -> None:
        """Close the connection; never raises."""
        ...


def write_verified(link: Link, block: Block, registers: Sequence[int], *, single: bool = False) -> None:
    """Write a block and read it back.

    Raises:
        LinkError: if the device does not hold exactly these registers.
    """
    link.write(block.address, registers, block.kind, single=single)
    read_back = link.read(block)
    if read_back != tuple(registers):
        raise LinkError(
            f"{link.where} did not take the command: {list(registers)} was written from register {block.address}, "
            f"{list(read_back)} was read back; check the device's limits and who else commands it"
        )


def action_name(verb: str, kind: Kind, address: int) -> str:
    """A request in an error message: ``reading holding register 100``."""
    return f"{verb} {kind.entry_name} {address}"


def refusal(where: str, action: str, code: int) -> Refused:
    """The error for an exception that a device answered.

    Args:
        where: name of the unit.
        action: as of `action_name`.
        code: Modbus exception code.
    """
    return Refused(f"{where} refused {action}: {EXCEPTIONS.get(code, f'exception {code}')}", code)
