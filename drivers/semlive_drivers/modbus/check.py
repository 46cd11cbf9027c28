"""Looks at a device that a register map describes: identity, plausibility, order of words. It reads and never writes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

from semlive.data.checks import Finding, FrameCheck, Verdict
from semlive.errors import LinkError, LinkRefused
from semlive_drivers.device_part import OrderBook
from semlive_drivers.modbus.client import Link
from semlive_drivers.modbus.codec import block_of, decode, number_in, require_in_range
from semlive_drivers.modbus.device_map import DeviceMap, load_map
from semlive_drivers.modbus.orders import DescribedOrders
from semlive_drivers.modbus.part import open_link, probe_blocks
from semlive_drivers.modbus.registers import RegisterPoint, WordOrder, overridden_points
from semlive_drivers.modbus.settings import PartSettings, checked

_BETWEEN_S = 0.3
_SMALL, _LARGE = 1e-15, 1e7
_ORDERS = {
    (WordOrder.HIGH_FIRST, WordOrder.HIGH_FIRST): "high word first",
    (WordOrder.LOW_FIRST, WordOrder.HIGH_FIRST): "low word first",
    (WordOrder.HIGH_FIRST, WordOrder.LOW_FIRST): "high word first, bytes swapped",
    (WordOrder.LOW_FIRST, WordOrder.LOW_FIRST): "low word first, bytes swapped",
}

Registers = dict[str, tuple[int, ...]]


def check_modbus(
    name: str, settings: Mapping[str, object], orders: Callable[[OrderBook], Iterable[Finding]] = lambda book: ()
) -> FrameCheck:
    """Read what a description names, and hold it beside it.

    Args:
        name: of the description, or a path.
        settings: as of the driver.
        orders: looks at the orders that the device can hold.

    Raises:
        BadConfig: for settings or a description that are not understood.
        LinkRefused: if nobody answers.
    """
    known = checked(PartSettings, {**settings, "map": name}, "frame check")
    device = load_map(name)
    points = overridden_points({key: text.point() for key, text in device.points.items()}, known.registers, "frame check: registers")
    link = open_link(known, device, probe_blocks(device, points))
    try:
        read, findings = _read_all(link, points)
        findings += _identity(device, read)
        findings += _values(device, points, read)
        findings += _orders(device, points, read)
        findings += _validity(device, read)
        findings += _counting(link, device, points, read)
        findings += orders(DescribedOrders(device, points))
    finally:
        link.close()
    return FrameCheck(device.name, link.where, device.source, device.confirmed or known.confirmed, tuple(findings))


def _read_all(link: Link, points: Mapping[str, RegisterPoint]) -> tuple[Registers, list[Finding]]:
    """Each point for itself, so that a missing register is named."""
    read: Registers = {}
    missing: list[Finding] = []
    silent: LinkError | None = None
    for name, point in points.items():
        try:
            read[name] = link.read(block_of((point,)))
        except LinkError as error:
            missing.append(Finding(name, str(error), Verdict.FAILED, f"correct the address of {name}, or take it out"))
            if "exception" not in str(error):
                silent = silent or error
                link.resync()
    if not read and silent is not None:  # nobody is there, and a list of registers would hide that
        raise LinkRefused(f"{silent}, and that host, port and unit are its own") from silent
    return read, missing


def _identity(device: DeviceMap, read: Registers) -> Iterator[Finding]:
    if not device.identity:
        yield Finding("identity", "the description has none", Verdict.UNKNOWN, "make sure that host, port and unit are this machine's")
    for condition in device.identity:
        if condition.point in read:
            said = read[condition.point][0]
            wanted = " or ".join(f"{value:#06x}" for value in condition.equals)
            good = condition.holds(said)
            yield Finding(
                condition.point,
                f"{said:#06x}",
                Verdict.OK if good else Verdict.FAILED,
                "" if good else f"{wanted} was expected: another device?",
            )


def _values(device: DeviceMap, points: Mapping[str, RegisterPoint], read: Registers) -> Iterator[Finding]:
    """Every value in words; those with a range are judged by it."""
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
        said = f"{value:g} ({' '.join(f'{word:04x}' for word in registers)})"
        if name not in device.plausible:
            yield Finding(name, said, Verdict.UNKNOWN)
            continue
        low, high = device.plausible[name]
        good = low <= value <= high
        advice = "" if good else f"{low:g} to {high:g} is plausible at rest: check address, type, scale and order of words"
        yield Finding(name, said, Verdict.OK if good else Verdict.FAILED, advice)


def _orders(device: DeviceMap, points: Mapping[str, RegisterPoint], read: Registers) -> Iterator[Finding]:
    """Which orders of words and bytes make sense of the long numbers that can be judged."""
    makes_sense = dict.fromkeys(_ORDERS, True)
    judged = []
    for name in read:
        point = points[name]
        if point.dtype.registers == 1 or not any(read[name]) or not (point.dtype.is_float or name in device.plausible):
            continue
        judged.append(name)
        for order in _ORDERS:
            makes_sense[order] &= _sensible(replace(point, words=order[0], byte_order=order[1]), name, device, read)
    if not judged:
        yield Finding("order of words", "no long number is other than zero", Verdict.UNKNOWN, "load the cell a little and look again")
        return
    # Swapped bytes are rare, and make sense of small numbers by chance: they are looked at only where nothing else does.
    plain = [order for order in _ORDERS if makes_sense[order] and order[1] is WordOrder.HIGH_FIRST]
    sensible = [_ORDERS[order] for order in plain or _ORDERS if makes_sense[order]]
    used = {(points[name].words, points[name].byte_order) for name in judged}
    said = f"{', '.join(judged)}: {' or '.join(sensible) or 'no order'} makes sense"
    fits = all(makes_sense[order] for order in used)
    if not fits:
        yield Finding(
            "order of words", said, Verdict.FAILED, f"the description says {', '.join(_ORDERS[order] for order in used)}: correct it"
        )
    elif len(sensible) > 1:
        yield Finding("order of words", said, Verdict.UNKNOWN, "load the cell a little and look again")
    else:
        yield Finding("order of words", said, Verdict.OK)


def _sensible(point: RegisterPoint, name: str, device: DeviceMap, read: Registers) -> bool:
    try:
        value = decode(point, read[name], read)
    except LinkError:
        return False
    low, high = device.plausible.get(name, (-_LARGE, _LARGE))
    return low <= value <= high and (not point.dtype.is_float or value == 0 or abs(value) > _SMALL)


def _validity(device: DeviceMap, read: Registers) -> Iterator[Finding]:
    for condition in device.valid:
        if condition.point in read and not condition.holds(read[condition.point][0]):
            yield Finding(condition.point, condition.says, Verdict.FAILED, "every reading would be refused until that is mended")


def _counting(link: Link, device: DeviceMap, points: Mapping[str, RegisterPoint], read: Registers) -> Iterator[Finding]:
    name = device.tells.counter
    if name is None or name not in read:
        return
    time.sleep(_BETWEEN_S)
    first, second = (int(number_in(points[name], words)) for words in (read[name], link.read(block_of((points[name],)))))
    good = first != second
    advice = "" if good else f"it stood still for {_BETWEEN_S:g} s: check the sensor, or the address"
    yield Finding(f"{name} goes on", f"{first}, then {second}", Verdict.OK if good else Verdict.FAILED, advice)
