"""Remedy for each Modbus exception with which a device refuses a reading. Pure.

Modbus application protocol V1.1b3, section 7.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from semlive.data.checks import Finding, Verdict
from semlive_drivers.modbus.link import EXCEPTIONS

PASSING = (5, 6)
"""Exceptions that a later request may not meet: the device needs longer, or is busy."""
GATEWAY = (10, 11)
"""Exceptions of a gateway, not of the device behind it."""

_ADVICE = {
    1: "use the other kind of {names} (holding instead of input, or the reverse): the device does not serve this function code",
    2: "correct the address of {names}: addresses count from 0 here, and many manuals count from 1, 30001 or 40001; or take it out",
    3: "correct address and dtype of {names}, or set max_block: the device does not allow this start or this number of registers",
    4: "look for an alarm on the device's panel and check --unit, then switch the device off and on",
    5: "wait until the device has finished, then check again",
    6: "try again when the device has finished, and end other programs that use it",
    7: "reset the watchdog of the device as its manual states, then check again",
    8: "switch the device off and on; if the exception stays, its memory is damaged and it needs repair",
    10: "check --unit and the routing table of the gateway: it has no line on which this unit could be",
    11: "check --unit, and cable, baud rate and parity on the serial side of the gateway: the device behind it did not answer",
}
_OTHER = "look the exception up in the manual of the device"


def exception_advice(code: int, names: str) -> str:
    """The remedy for an exception.

    Args:
        code: Modbus exception code.
        names: points that were refused, for the text.
    """
    return _ADVICE.get(code, _OTHER).format(names=names)


def refusal_findings(where: str, refused: Mapping[str, int], requests: Mapping[str, str]) -> Iterator[Finding]:
    """One finding for each exception code.

    Args:
        where: name of the unit.
        refused: exception code by point.
        requests: what was read, by point: ``input register 4``.
    """
    for code in dict.fromkeys(refused.values()):
        names = [name for name, other in refused.items() if other == code]
        meaning = EXCEPTIONS.get(code, f"exception {code}")
        observation = f"{where} refused reading {_listed([requests[name] for name in names])}: {meaning}"
        yield Finding(", ".join(names), observation, Verdict.FAILED, exception_advice(code, _listed(names)))


def _listed(items: Sequence[str]) -> str:
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
