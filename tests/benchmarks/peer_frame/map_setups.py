"""Every shipped map and every driver of a load frame, each with a device that it is written for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from .scenario import Settings

_LINE1 = {"port": "{folder}/line1"}
_LINE2 = {"port": "{folder}/line2"}


@dataclass(frozen=True, slots=True)
class Setup:
    """A load frame of one driver.

    Attributes:
        name: begins the names of its scenarios.
        kind: which device (`KINDS` in map_device.py).
        maps: shipped maps that it needs.
        driver: of the load frame.
        frame: settings of the driver.
        device: characters of the machine.
        limits: changes to `limits`.
        has_counter: a counter of readings is read.
        has_force_loop: the machine goes to a load by its own control; else it is moved by short travels, or by a person.
        hand: a person moves the machine; ``types`` if the person types the load as well.
        parts: links by what hangs on them, where there are several.
    """

    name: str
    kind: str
    maps: tuple[str, ...]
    driver: str
    frame: Settings
    device: Settings = field(default_factory=dict)
    limits: Settings = field(default_factory=dict)
    has_counter: bool = False
    has_force_loop: bool = False
    hand: str = ""
    parts: Mapping[str, int] = field(default_factory=dict)


_HOST: Settings = {"host": "127.0.0.1", "port": "{port}"}
_TCP: Settings = {**_HOST, "confirmed": True}
_RTU: Settings = {"serial": _LINE1, "confirmed": True}
_RTU_NO_PARITY: Settings = {"serial": {**_LINE1, "parity": "none"}, "confirmed": True}
_CELL_FIRST, _DRIVE_FIRST = {"cell": 1, "drive": 2}, {"drive": 1, "cell": 2}
_CSV = {"file": "{folder}/load.csv", "force": {"column": "Force"}}


def _compliant(stiffness_n_mm: float, noise_n: float) -> dict[str, object]:
    """A specimen that suits a drive with coarse steps; any motion of its own control is as fast as 120 N/s."""
    return {"stiffness_n_mm": stiffness_n_mm, "speed_mm_s": 120.0 / stiffness_n_mm, "noise_n": noise_n}


def _assembled(
    name: str,
    maps: tuple[str, ...],
    cell: Settings,
    drive: Settings,
    stiffness_n_mm: int,
    parts: Mapping[str, int] = MappingProxyType({}),
    others: Settings = MappingProxyType({}),
    **approach: float,
) -> Setup:
    """A load frame of a cell and a drive, with a specimen of the stiffness that the approach is set for."""
    frame = {
        "cell": cell,
        "drive": drive,
        **others,
        "approach": {"stiffness_n_mm": stiffness_n_mm, "speed_max_mm_s": 0.1, **approach},
    }
    specimen = _compliant(float(stiffness_n_mm), 100.0 / stiffness_n_mm)
    return Setup(name, name.replace("-", "_"), maps, "assembled", frame, specimen, parts=parts)


def _ascii(shipped: str, line: Settings) -> dict[str, object]:
    """A device of a shipped text map at a serial line."""
    return {"protocol": "ascii", "map": shipped, "serial": line}


_PI: Settings = {**_ascii("pi_c863", _LINE1), "confirmed": True}
_ORIENTAL: Settings = {"map": "oriental_az", "confirmed": True, "unit": 1, "serial": {**_LINE2, "parity": "none"}}
_FAST_LINE: Settings = {**_LINE1, "baud": 38400}
_MARK10: Settings = {
    "map": "mark10_esm",
    "serial": _LINE1,
    "confirmed": True,
    "approach": {"stiffness_n_mm": 150, "speed_max_mm_s": 0.5, "travel_max_mm": 3.0},
}

SETUPS: tuple[Setup, ...] = (
    Setup("bench-tcp", "bench_tcp", ("bench",), "modbus", {"map": "bench", **_TCP}, has_counter=True, has_force_loop=True),
    Setup("bench-rtu", "bench_rtu", ("bench",), "modbus", {"map": "bench", **_RTU}, has_counter=True, has_force_loop=True),
    Setup("generic-tcp", "generic_tcp", ("generic",), "modbus", {"map": "generic", **_TCP}, has_force_loop=True),
    Setup("generic-rtu", "generic_rtu", ("generic",), "modbus", {"map": "generic", **_RTU_NO_PARITY}, has_force_loop=True),
    Setup("mark10", "mark10", ("mark10_esm",), "ascii", _MARK10, _compliant(150.0, 0.15), {"extension_max_mm": 4.0}),
    _assembled(
        "laumas-leadshine",
        ("laumas_tlb", "leadshine_rs"),
        {"map": "laumas_tlb", "serial": _FAST_LINE, "unit": 1},
        {"map": "leadshine_rs", "serial": _FAST_LINE, "unit": 2, "confirmed": True, "registers": {"speed": {"scale": 0.005}}},
        1000,
        speed_min_mm_s=0.005,
    ),
    _assembled(
        "mantracourt-oriental-wago",
        ("mantracourt_dsc", "oriental_az", "wago_watchdog"),
        _ascii("mantracourt_dsc", _LINE1),
        _ORIENTAL,
        2000,
        {**_CELL_FIRST, "watchdog": 3},
        {"watchdog": {"map": "wago_watchdog", **_HOST}},
    ),
    _assembled("flintec-pi", ("flintec_dad141", "pi_c863"), {"map": "flintec_dad141", **_HOST}, _PI, 1000, _DRIVE_FIRST),
    _assembled("mark10-gauge-pi", ("mark10_gauge", "pi_c863"), _ascii("mark10_gauge", _LINE2), _PI, 1000, _DRIVE_FIRST),
    _assembled("imada-oriental", ("imada_gauge", "oriental_az"), _ascii("imada_gauge", _LINE1), _ORIENTAL, 2000, _CELL_FIRST),
    _assembled("mettler-oriental", ("mettler_sics", "oriental_az"), _ascii("mettler_sics", _LINE1), _ORIENTAL, 2000, _CELL_FIRST),
    _assembled(
        "seneca-pi",
        ("seneca_sg3", "pi_c863"),
        {"map": "seneca_sg3", **_HOST, "registers": {"gross": {"range": [-1000, 1000]}}},
        _PI,
        1000,
        _DRIVE_FIRST,
    ),
    _assembled("csv-oriental", ("oriental_az",), {"protocol": "csv", **_CSV}, {**_ORIENTAL, "serial": {**_LINE1, "parity": "none"}}, 2000),
    Setup(
        "operator-csv",
        "hand",
        (),
        "operator",
        {"arrived_n": 2.5, "load_file": {**_CSV, "extension": {"column": "Extension"}}},
        {"stopdelay": 0.5},
        hand="confirms",
    ),
    Setup("operator", "hand", (), "operator", {"arrived_n": 2.5}, {"stopdelay": 0.5}, hand="types"),
)
"""A person stops the machine 0.5 s after the request is displayed."""
