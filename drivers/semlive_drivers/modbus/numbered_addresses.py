"""Addresses in the notation with six digits (400001, 300001), which no device has: for the check of a description."""

from __future__ import annotations

from typing import Any

from semlive.data.checks import Finding, Verdict
from semlive_drivers.maps import map_content, validate_map
from semlive_drivers.modbus.device_map import DeviceMap

_BASES = {3: ("input", 300_001), 4: ("holding", 400_001)}
_LARGEST = 65_535


def load_numbered_map(name: str) -> tuple[DeviceMap, list[Finding]]:
    """A register map by name or path, with addresses of six digits as the device counts them.

    Returns:
        The map, and one finding that lists the changed addresses, if there are any.

    Raises:
        BadConfig: if the map does not exist or is not valid otherwise.
    """
    content = map_content(name)
    points = content.get("points")
    changed = {point: moved for point, fields in points.items() if (moved := _moved(fields))} if isinstance(points, dict) else {}
    if not changed:
        return validate_map(DeviceMap, name), []
    described = validate_map(DeviceMap, name, {**content, "points": {**(points or {}), **changed}})
    places = "; ".join(f"{point}: {{kind: {fields['kind']}, address: {fields['address']}}}" for point, fields in changed.items())
    finding = Finding(
        "addresses",
        f"{', '.join(changed)}: numbers of six digits, with the table as the first digit",
        Verdict.FAILED,
        f"write the addresses as on the wire, from 0: {places}; the rest of this check used them",
    )
    return described, [finding]


def _moved(fields: Any) -> dict[str, Any] | None:
    """The fields of a point with table and address on the wire; None if its address has less than six digits."""
    address = fields.get("address") if isinstance(fields, dict) else None
    if not isinstance(address, int) or address <= _LARGEST or address // 100_000 not in _BASES:
        return None
    kind, base = _BASES[address // 100_000]
    return {**fields, "kind": kind, "address": max(0, address - base)}
