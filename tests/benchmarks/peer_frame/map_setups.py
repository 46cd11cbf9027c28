"""Every shipped map and every driver of a load frame, each with a device that it is written for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

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


_TCP = {"host": "127.0.0.1", "port": "{port}", "confirmed": True}
_ORIENTAL = {"map": "oriental_az", "confirmed": True, "unit": 1}
_CSV = {"file": "{folder}/load.csv", "force": {"column": "Force"}}


def _compliant(stiffness_n_mm: float, noise_n: float) -> dict[str, object]:
    """A specimen that suits a drive with coarse steps; any motion of its own control is as fast as 120 N/s."""
    return {"stiffness_n_mm": stiffness_n_mm, "speed_mm_s": 120.0 / stiffness_n_mm, "noise_n": noise_n}


SETUPS: tuple[Setup, ...] = (
    Setup("bench-tcp", "bench_tcp", ("bench",), "modbus", {"map": "bench", **_TCP}, has_counter=True, has_force_loop=True),
    Setup(
        "bench-rtu",
        "bench_rtu",
        ("bench",),
        "modbus",
        {"map": "bench", "serial": _LINE1, "confirmed": True},
        has_counter=True,
        has_force_loop=True,
    ),
    Setup("generic-tcp", "generic_tcp", ("generic",), "modbus", {"map": "generic", **_TCP}, has_force_loop=True),
    Setup(
        "generic-rtu",
        "generic_rtu",
        ("generic",),
        "modbus",
        {"map": "generic", "serial": {**_LINE1, "parity": "none"}, "confirmed": True},
        has_force_loop=True,
    ),
    Setup(
        "mark10",
        "mark10",
        ("mark10_esm",),
        "ascii",
        {
            "map": "mark10_esm",
            "serial": _LINE1,
            "confirmed": True,
            "approach": {"stiffness_n_mm": 150, "speed_max_mm_s": 0.5, "travel_max_mm": 3.0},
        },
        _compliant(150.0, 0.15),
        {"extension_max_mm": 4.0},
    ),
    Setup(
        "laumas-leadshine",
        "laumas_leadshine",
        ("laumas_tlb", "leadshine_rs"),
        "assembled",
        {
            "cell": {"map": "laumas_tlb", "serial": {**_LINE1, "baud": 38400}, "unit": 1},
            "drive": {
                "map": "leadshine_rs",
                "serial": {**_LINE1, "baud": 38400},
                "unit": 2,
                "confirmed": True,
                "registers": {"speed": {"scale": 0.005}},
            },
            "approach": {"stiffness_n_mm": 1000, "speed_max_mm_s": 0.1, "speed_min_mm_s": 0.005},
        },
        _compliant(1000.0, 0.1),
    ),
    Setup(
        "mantracourt-oriental-wago",
        "mantracourt_oriental_wago",
        ("mantracourt_dsc", "oriental_az", "wago_watchdog"),
        "assembled",
        {
            "cell": {"protocol": "ascii", "map": "mantracourt_dsc", "serial": _LINE1},
            "drive": {**_ORIENTAL, "serial": {**_LINE2, "parity": "none"}},
            "watchdog": {"map": "wago_watchdog", "host": "127.0.0.1", "port": "{port}"},
            "approach": {"stiffness_n_mm": 2000, "speed_max_mm_s": 0.1},
        },
        _compliant(2000.0, 0.05),
        parts={"cell": 1, "drive": 2, "watchdog": 3},
    ),
    Setup(
        "flintec-pi",
        "flintec_pi",
        ("flintec_dad141", "pi_c863"),
        "assembled",
        {
            "cell": {"map": "flintec_dad141", "host": "127.0.0.1", "port": "{port}"},
            "drive": {"protocol": "ascii", "map": "pi_c863", "serial": _LINE1, "confirmed": True},
            "approach": {"stiffness_n_mm": 1000, "speed_max_mm_s": 0.1},
        },
        _compliant(1000.0, 0.1),
        parts={"drive": 1, "cell": 2},
    ),
    Setup(
        "mark10-gauge-pi",
        "mark10_gauge_pi",
        ("mark10_gauge", "pi_c863"),
        "assembled",
        {
            "cell": {"protocol": "ascii", "map": "mark10_gauge", "serial": _LINE2},
            "drive": {"protocol": "ascii", "map": "pi_c863", "serial": _LINE1, "confirmed": True},
            "approach": {"stiffness_n_mm": 1000, "speed_max_mm_s": 0.1},
        },
        _compliant(1000.0, 0.1),
        parts={"drive": 1, "cell": 2},
    ),
    Setup(
        "imada-oriental",
        "imada_oriental",
        ("imada_gauge", "oriental_az"),
        "assembled",
        {
            "cell": {"protocol": "ascii", "map": "imada_gauge", "serial": _LINE1},
            "drive": {**_ORIENTAL, "serial": {**_LINE2, "parity": "none"}},
            "approach": {"stiffness_n_mm": 2000, "speed_max_mm_s": 0.1},
        },
        _compliant(2000.0, 0.05),
        parts={"cell": 1, "drive": 2},
    ),
    Setup(
        "mettler-oriental",
        "mettler_oriental",
        ("mettler_sics", "oriental_az"),
        "assembled",
        {
            "cell": {"protocol": "ascii", "map": "mettler_sics", "serial": _LINE1},
            "drive": {**_ORIENTAL, "serial": {**_LINE2, "parity": "none"}},
            "approach": {"stiffness_n_mm": 2000, "speed_max_mm_s": 0.1},
        },
        _compliant(2000.0, 0.05),
        parts={"cell": 1, "drive": 2},
    ),
    Setup(
        "seneca-pi",
        "seneca_pi",
        ("seneca_sg3", "pi_c863"),
        "assembled",
        {
            "cell": {"map": "seneca_sg3", "host": "127.0.0.1", "port": "{port}", "registers": {"gross": {"range": [-1000, 1000]}}},
            "drive": {"protocol": "ascii", "map": "pi_c863", "serial": _LINE1, "confirmed": True},
            "approach": {"stiffness_n_mm": 1000, "speed_max_mm_s": 0.1},
        },
        _compliant(1000.0, 0.1),
        parts={"drive": 1, "cell": 2},
    ),
    Setup(
        "csv-oriental",
        "csv_oriental",
        ("oriental_az",),
        "assembled",
        {
            "cell": {"protocol": "csv", **_CSV},
            "drive": {**_ORIENTAL, "serial": {**_LINE1, "parity": "none"}},
            "approach": {"stiffness_n_mm": 2000, "speed_max_mm_s": 0.1},
        },
        _compliant(2000.0, 0.05),
    ),
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
