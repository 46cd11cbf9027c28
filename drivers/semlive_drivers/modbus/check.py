"""Check of a device against its register map: identity, plausible values, order of words. It reads and never writes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

from semlive.data.checks import Finding, FrameCheck, Verdict
from semlive.errors import LinkError, LinkRefused
from semlive_drivers.device_part import OrderBook
from semlive_drivers.modbus.codec import block_of, decode, number_in, require_in_range
from semlive_drivers.modbus.device import open_link, probe_blocks
from semlive_drivers.modbus.device_map import DeviceMap, load_map
from semlive_drivers.modbus.link import Link
from semlive_drivers.modbus.orders.requests import DescribedOrders
from semlive_drivers.modbus.registers import RegisterPoint, WordOrder, overridden_points
from semlive_drivers.modbus.settings import PartSettings
from semlive_drivers.settings import checked

_COUNTER_WAIT_S = 0.3
"""Time between two readings of the counter of readings."""
_MIN_VALUE, _MAX_VALUE = 1e-15, 1e7
"""Range of the magnitude of a value without a plausible range in the map."""
_WORD_ORDERS = {
    (WordOrder.HIGH_FIRST, WordOrder.HIGH_FIRST): "high word first",
    (WordOrder.LOW_FIRST, WordOrder.HIGH_FIRST): "low word first",
    (WordOrder.HIGH_FIRST, WordOrder.LOW_FIRST): "high word first, bytes swapped",
    (WordOrder.LOW_FIRST, WordOrder.LOW_FIRST): "low word first, bytes swapped",
}

Registers = dict[str, tuple[int, ...]]


def check_modbus(
    name: str, settings: Mapping[str, object], orders: Callable[[OrderBook], Iterable[Finding]] = lambda book: ()
) -> FrameCheck:
    """Read the points of a description and compare them with it.

    Args:
        name: name of the description, or a path.
        settings: as of the driver.
        orders: checks orders against those that the device can take.

    Raises:
        BadConfig: for settings or a description that are not valid.
        LinkRefused: if no device answers.
    """
    config = checked(PartSettings, {**settings, "map": name}, "frame check")
    device = load_map(name)
    points = overridden_points({key: text.point() for key, text in device.points.items()}, config.registers, "frame check: registers")
    link = open_link(config, device, probe_blocks(device, points))
    try:
        read, findings = _read_all(link, points)
        findings += _identity(device, read)
        findings += _values(device, points, read)
        findings += _word_orders(device, points, read)
        findings += _validity(device, read)
        findings += _counting(link, device, points, read)
        findings += orders(DescribedOrders(device, points))
    finally:
        link.close()
    return FrameCheck(device.name, link.where, device.source, device.confirmed or config.confirmed, tuple(findings))


def _read_all(link: Link, points: Mapping[str, RegisterPoint]) -> tuple[Registers, list[Finding]]:
    """Read each point in its own request, so that a missing register is named."""
    read: Registers = {}
    missing: list[Finding] = []
    first_failure: LinkError | None = None
    for name, point in points.items():
        try:
            read[name] = link.read(block_of((point,)))
        except LinkError as error:
            missing.append(Finding(name, str(error), Verdict.FAILED, f"correct the address of {name}, or take it out"))
            if "exception" not in str(error):
                first_failure = first_failure or error
                link.resync()
    if not read and first_failure is not None:  # no device answers, and a list of registers would hide that
        raise LinkRefused(f"{first_failure}, and that host, port and unit are its own") from first_failure
    return read, missing


def _identity(device: DeviceMap, read: Registers) -> Iterator[Finding]:
    if not device.identity:
        yield Finding("identity", "the description has none", Verdict.UNKNOWN, "make sure that host, port and unit are this machine's")
    for condition in device.identity:
        if condition.point in read:
            identity = read[condition.point][0]
            expected = " or ".join(f"{value:#06x}" for value in condition.equals)
            passed = condition.holds(identity)
            yield Finding(
                condition.point,
                f"{identity:#06x}",
                Verdict.OK if passed else Verdict.FAILED,
                "" if passed else f"{expected} was expected: another device?",
            )


def _values(device: DeviceMap, points: Mapping[str, RegisterPoint], read: Registers) -> Iterator[Finding]:
    """Every value; those with a plausible range are compared with it."""
    for name, registers in read.items():
        if any(condition.point == name for condition in device.identity):
            continue
        try:
            value = decode(points[name], registers, read)
            if name in (device.tells.force, device.tells.extension):
                require_in_range(name, points[name], registers, value, unsigned=name == device.tells.force)
        except (LinkError, KeyError) as error:
            yield Finding(name, str(error), Verdict.FAILED, "check the sensor and the description")
            continue
        text = f"{value:g} ({' '.join(f'{register:04x}' for register in registers)})"
        if name not in device.plausible:
            yield Finding(name, text, Verdict.UNKNOWN)
            continue
        low, high = device.plausible[name]
        passed = low <= value <= high
        advice = "" if passed else f"{low:g} to {high:g} is plausible at rest: check address, type, scale and order of words"
        yield Finding(name, text, Verdict.OK if passed else Verdict.FAILED, advice)


def _word_orders(device: DeviceMap, points: Mapping[str, RegisterPoint], read: Registers) -> Iterator[Finding]:
    """Register and byte orders that give plausible values of the numbers with several registers."""
    plausible = dict.fromkeys(_WORD_ORDERS, True)
    tested = []
    for name in read:
        point = points[name]
        if point.dtype.registers == 1 or not any(read[name]) or not (point.dtype.is_float or name in device.plausible):
            continue
        tested.append(name)
        for order in _WORD_ORDERS:
            plausible[order] &= _is_plausible(replace(point, word_order=order[0], byte_order=order[1]), name, device, read)
    if not tested:
        yield Finding(
            "order of words", "every number with several registers is zero", Verdict.UNKNOWN, "load the cell a little and check again"
        )
        return
    # Swapped bytes are rare, and small numbers are plausible with them by chance: they are tested only if no other order is plausible.
    plain = [order for order in _WORD_ORDERS if plausible[order] and order[1] is WordOrder.HIGH_FIRST]
    names = [_WORD_ORDERS[order] for order in plain or _WORD_ORDERS if plausible[order]]
    used = {(points[name].word_order, points[name].byte_order) for name in tested}
    text = f"{', '.join(tested)}: {' or '.join(names) or 'no order'} makes sense"
    fits = all(plausible[order] for order in used)
    if not fits:
        yield Finding(
            "order of words", text, Verdict.FAILED, f"the description states {', '.join(_WORD_ORDERS[order] for order in used)}: correct it"
        )
    elif len(names) > 1:
        yield Finding("order of words", text, Verdict.UNKNOWN, "load the cell a little and check again")
    else:
        yield Finding("order of words", text, Verdict.OK)


def _is_plausible(point: RegisterPoint, name: str, device: DeviceMap, read: Registers) -> bool:
    try:
        value = decode(point, read[name], read)
    except LinkError:
        return False
    low, high = device.plausible.get(name, (-_MAX_VALUE, _MAX_VALUE))
    return low <= value <= high and (not point.dtype.is_float or value == 0 or abs(value) > _MIN_VALUE)


def _validity(device: DeviceMap, read: Registers) -> Iterator[Finding]:
    for condition in device.valid:
        if condition.point in read and not condition.holds(read[condition.point][0]):
            yield Finding(condition.point, condition.says, Verdict.FAILED, "every reading would be refused until that is corrected")


def _counting(link: Link, device: DeviceMap, points: Mapping[str, RegisterPoint], read: Registers) -> Iterator[Finding]:
    name = device.tells.counter
    if name is None or name not in read:
        return
    time.sleep(_COUNTER_WAIT_S)
    first, second = (int(number_in(points[name], registers)) for registers in (read[name], link.read(block_of((points[name],)))))
    passed = first != second
    advice = "" if passed else f"it did not change for {_COUNTER_WAIT_S:g} s: check the sensor, or the address"
    yield Finding(f"{name} counts", f"{first}, then {second}", Verdict.OK if passed else Verdict.FAILED, advice)
