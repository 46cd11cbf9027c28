"""Check of a device against its register map: identity, plausible values, layout, panel readings. It reads and never writes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

from semlive.data.checks import Finding, FrameCheck, Verdict
from semlive.errors import LinkError, LinkRefused
from semlive_drivers.device_part import OrderBook
from semlive_drivers.maps import is_of_a_machine
from semlive_drivers.modbus.checking.answers import describe_answer
from semlive_drivers.modbus.checking.choices import FORCE_UNITS, LENGTH_UNITS, Measured
from semlive_drivers.modbus.checking.diagnosis import Diagnosis, diagnose
from semlive_drivers.modbus.checking.explanations import Described
from semlive_drivers.modbus.checking.reader import Reader, Register
from semlive_drivers.modbus.checking.refusals import refusal_findings
from semlive_drivers.modbus.checking.variants import COUNTED, WRITTEN, is_numbered
from semlive_drivers.modbus.codec import block_of, decode, number_in, require_in_range
from semlive_drivers.modbus.device import open_link, probe_blocks
from semlive_drivers.modbus.device_map import DeviceMap
from semlive_drivers.modbus.link import Refused
from semlive_drivers.modbus.numbered_addresses import load_numbered_map
from semlive_drivers.modbus.orders.requests import DescribedOrders
from semlive_drivers.modbus.registers import RegisterPoint, overridden_points
from semlive_drivers.modbus.settings import PartSettings
from semlive_drivers.panel_reading import PanelReading, panel_readings
from semlive_drivers.settings import checked
from semlive_drivers.units import factor

_COUNTER_WAIT_S = 0.3
"""Time between two readings of the counter of readings."""
_SAMPLES, _SAMPLE_WAIT_S = 6, 0.05
"""Readings of the registers near the measured numbers, and the time between them."""

Registers = dict[str, tuple[int, ...]]


def check_modbus(
    name: str, settings: Mapping[str, object], orders: Callable[[OrderBook], Iterable[Finding]] = lambda book: ()
) -> FrameCheck:
    """Read the points of a description and compare them with it.

    Args:
        name: name of the description, or a path.
        settings: as of the driver, with the readings of the device's panel under the keys of `panel_reading.OPTIONS`.
        orders: checks orders against those that the device can take.

    Raises:
        BadConfig: for settings or a description that are not valid.
        LinkRefused: if no device answers, or its answers cannot be used.
    """
    panel, driver_settings = panel_readings(settings)
    config = checked(PartSettings, {**driver_settings, "map": name}, "frame check")
    device, renumbered = load_numbered_map(name)
    points = overridden_points({key: text.point() for key, text in device.points.items()}, config.registers, "frame check: registers")
    reader = Reader(lambda: open_link(config, device, probe_blocks(device, points)), device.max_block)
    try:
        read, findings = _read_all(reader, config, points)
        findings += renumbered
        findings += _identity(device, read)
        findings += _values(device, points, read)
        shipped = {key: text.point() for key, text in device.points.items()} if is_of_a_machine(name) else None
        diagnosis = _layout(reader, Described(device, points, _measured(device, points, panel)), read, shipped)
        findings += diagnosis.findings
        findings += _validity(device, read)
        findings += _counting(reader, device, points, read)
        findings += orders(DescribedOrders(device, points))
        findings += _lost(reader)
    finally:
        reader.close()
    proved = diagnosis.proved or (is_of_a_machine(name) and not config.registers)
    return FrameCheck(device.name, reader.where, device.source, device.confirmed or config.confirmed, tuple(findings), proved)


def _read_all(reader: Reader, config: PartSettings, points: Mapping[str, RegisterPoint]) -> tuple[Registers, list[Finding]]:
    """Read each point in its own request, so that a missing register is named."""
    read: Registers = {}
    refused: dict[str, int] = {}
    findings: list[Finding] = []
    for name, point in points.items():
        block = block_of((point,))
        try:
            read[name] = reader.read(block)
        except Refused as error:
            refused[name] = error.code
        except LinkError as error:
            if not reader.answered:
                raise _refused(reader, config, point, error) from error
            findings.append(
                Finding(name, str(error), Verdict.FAILED, "the device answers other registers: check its address in the manual")
            )
    requests = {name: f"{point.kind.entry_name} {point.address}" for name, point in points.items()}
    return read, [*refusal_findings(reader.where, refused, requests), *findings]


def _refused(reader: Reader, config: PartSettings, point: RegisterPoint, error: LinkError) -> LinkRefused:
    """The error for a device of which no answer is of use, with what it really sends."""
    reader.close()
    answer = None
    if config.serial is None:
        answer = describe_answer(config.host, config.port, config.unit, block_of((point,)), config.timeout_s)
    if answer is not None:
        return LinkRefused(f"{reader.where}: {answer}")
    advice = "" if "check" not in str(error) else ", and that host, port and unit are its own"
    return LinkRefused(f"{error}{advice}")


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
                "" if passed else f"{expected} was expected: another device, or wrong addresses?",
            )


def _values(device: DeviceMap, points: Mapping[str, RegisterPoint], read: Registers) -> Iterator[Finding]:
    """Every value; those with a plausible range are compared with it, a motion state with the described ones."""
    motion = device.tells.motion
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
        if motion is not None and name == motion.point and motion.states and registers[0] not in motion.states:
            states = ", ".join(f"{number} {state}" for number, state in motion.states.items())
            yield Finding(name, text, Verdict.FAILED, f"the description states {states}: check its address")
        elif name not in device.plausible:
            yield Finding(name, text, Verdict.UNKNOWN)
        else:
            low, high = device.plausible[name]
            passed = low <= value <= high
            advice = "" if passed else f"{low:g} to {high:g} is plausible at rest: check address, type, scale and order of words"
            yield Finding(name, text, Verdict.OK if passed else Verdict.FAILED, advice)


def _layout(reader: Reader, near: Described, read: Registers, shipped: Mapping[str, RegisterPoint] | None) -> Diagnosis:
    """Search for all descriptions that explain the device; no findings if it refused every request, which is a finding of its own."""
    if not near.measured or not reader.answered:
        return Diagnosis((), not near.measured)
    numbered = is_numbered(near.points[one.name] for one in near.measured)
    diagnosis = Diagnosis((), proved=False, found=False)
    if not numbered and (samples := _samples(reader, near, read)):
        diagnosis = diagnose(near, samples, shipped)
    if diagnosis.found:
        return diagnosis
    far = replace(near, notations=WRITTEN if numbered else COUNTED)
    if not (samples := _samples(reader, far, read)):
        return diagnosis
    further = diagnose(far, samples, shipped)
    return further if numbered or further.found else diagnosis


def _samples(reader: Reader, described: Described, read: Registers) -> dict[Register, list[int]]:
    """Registers near the measured numbers, several times."""
    needed = described.needed()
    samples: dict[Register, list[int]] = {}
    for number in range(_SAMPLES):
        if number:
            time.sleep(_SAMPLE_WAIT_S)
        found = reader.search(needed)
        needed &= set(found)
        for place, value in found.items():
            samples.setdefault(place, []).append(value)
    for name, registers in read.items():  # registers that the device gives only in requests for the whole number
        for index, value in enumerate(registers):
            point = described.points[name]
            samples.setdefault((point.kind, point.address + index), [value])
    return samples


def _measured(device: DeviceMap, points: Mapping[str, RegisterPoint], panel: Mapping[str, PanelReading]) -> tuple[Measured, ...]:
    """The numbers that are explained: force and extension, or others with several registers if there are none."""
    tells = device.tells
    units = {tells.force: ("force_reads", tells.force_unit), tells.extension: ("extension_reads", tells.extension_unit)}
    names = [name for name in units if name is not None]
    if not names:
        names = [tells.strain_gage] if tells.strain_gage else [name for name in device.plausible if points[name].dtype.registers > 1][:2]
    found = []
    for name in names:
        key, unit = units.get(name, ("", "1"))
        reading = panel[key].in_unit(factor(unit, name)) if key in panel else None
        other_units = {"force_reads": FORCE_UNITS, "extension_reads": LENGTH_UNITS}.get(key, ())
        found.append(Measured(name, device.plausible.get(name), reading, other_units))
    return tuple(found)


def _validity(device: DeviceMap, read: Registers) -> Iterator[Finding]:
    for condition in device.valid:
        if condition.point in read and not condition.holds(read[condition.point][0]):
            yield Finding(condition.point, condition.says, Verdict.FAILED, "every reading would be refused until that is corrected")


def _counting(reader: Reader, device: DeviceMap, points: Mapping[str, RegisterPoint], read: Registers) -> Iterator[Finding]:
    name = device.tells.counter
    if name is None or name not in read:
        return
    time.sleep(_COUNTER_WAIT_S)
    first, second = (int(number_in(points[name], registers)) for registers in (read[name], reader.read(block_of((points[name],)))))
    passed = first != second
    advice = "" if passed else f"it did not change for {_COUNTER_WAIT_S:g} s: check the sensor, or the address"
    yield Finding(f"{name} counts", f"{first}, then {second}", Verdict.OK if passed else Verdict.FAILED, advice)


def _lost(reader: Reader) -> Iterator[Finding]:
    if reader.lost:
        yield Finding(
            "lost replies",
            f"{len(reader.lost)}, the first: {reader.lost[0]}",
            Verdict.UNKNOWN,
            "the link was opened again and the check continued; in a run each would be a fault: give a longer --timeout-s, check network, "
            "cable and who else uses the device",
        )
