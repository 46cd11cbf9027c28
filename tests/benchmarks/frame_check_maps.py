"""Right register maps of the simulated bench and the peer frame, and maps with errors made from them."""

from __future__ import annotations

import copy
import random
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pymodbus.client import ModbusTcpClient

Fields = dict[str, Any]
_OTHER = {"high_first": "low_first", "low_first": "high_first"}
_MEASURED = ("force", "extension")


@dataclass(frozen=True)
class Truth:
    """A device with its right map.

    Attributes:
        name: of the device and map.
        port: TCP port.
        content: the right map.
        panel: force in N and extension in mm as its panel shows them now.
    """

    name: str
    port: int
    content: Fields
    panel: Callable[[], tuple[str, str]]


@dataclass(frozen=True)
class Case:
    """A wrong map.

    Attributes:
        truth: the device.
        content: the wrong map.
        errors: kinds of the errors in it.
    """

    truth: Truth
    content: Fields
    errors: tuple[str, ...]

    def is_right(self, advice: str) -> bool:
        """Whether the points that an explanation gives make the map right."""
        points = copy.deepcopy({name: _whole(self.content["points"][name]) for name in _MEASURED})
        for name, given in ({} if advice == "as described" else _parsed(advice)).items():
            points[name] = _whole(given)
        return all(_same(points[name], _whole(self.truth.content["points"][name])) for name in _MEASURED)


def _parsed(advice: str) -> dict[str, Fields]:
    return {name: fields for part in advice.split("; ") for name, fields in yaml.safe_load(part).items()}


def _whole(fields: Fields) -> Fields:
    """The fields of a point with their defaults, and the address on the wire."""
    whole = {"dtype": "u16", "words": "high_first", "byte_order": "high_first", "scale": 1.0, **fields}
    if whole["address"] > 65_535:
        whole["kind"], whole["address"] = ("holding" if whole["address"] > 400_000 else "input"), whole["address"] % 100_000 - 1
    if whole["dtype"].endswith("16"):
        whole["words"] = "high_first"
    return whole


def _same(one: Fields, other: Fields) -> bool:
    keys = ("kind", "address", "dtype", "words", "byte_order")
    return all(one[key] == other[key] for key in keys) and abs(one["scale"] / other["scale"] - 1) < 1e-9


def _content(name: str, force: Fields, extension: Fields, motion: Fields, **more: Any) -> Fields:
    points = {"force": force, "extension": extension, "motion": motion}
    return {
        "protocol": "modbus",
        "name": name,
        "source": "tests",
        "points": points,
        "every_turn": [[point] for point in points],
        "tells": {"force": "force", "extension": "extension", "motion": {"point": "motion", "states": {0: "stopped", 1: "moving"}}},
        "plausible": {"force": [-10_000, 10_000], "extension": [-100, 100]},
        **more,
    }


def simulated_truth(port: int, force_n: float) -> Truth:
    """The simulated bench, with its map without identity: an own description often has none."""
    point = {"kind": "input", "dtype": "f32"}
    content = _content("bench", {**point, "address": 4}, {**point, "address": 6}, {"kind": "input", "address": 3})

    def panel() -> tuple[str, str]:
        """Read with pymodbus alone, to the digits that stand still."""
        found: list[tuple[float, float]] = []
        with ModbusTcpClient("127.0.0.1", port=port, timeout=10) as client:
            while len(found) < 6:
                registers = client.read_input_registers(3, count=5, device_id=1).registers
                force, extension = (struct.unpack(">f", struct.pack(">HH", *registers[at : at + 2]))[0] for at in (1, 3))
                if registers[0] == 0 and abs(force - force_n) < 1.0:
                    found.append((force, extension))
                time.sleep(0.02)
        return _digits([force for force, _ in found], 3), _digits([extension for _, extension in found], 4)

    return Truth(f"bench {force_n:g} N", port, content, panel)


def _digits(values: list[float], most: int) -> str:
    """The last value with as many decimals as stand still, at most those of a panel."""
    decimals = next(number for number in range(most, -1, -1) if 2 * (max(values) - min(values)) <= 10.0**-number or number == 0)
    return f"{values[-1]:.{decimals}f}"


@contextmanager
def peer_frame(executable: Path, folder: Path, **values: float) -> Iterator[int]:
    """TCP port of the independent frame with these true values, set over UDP."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    log = folder / "frame.log"
    process = subprocess.Popen([executable, str(port), str(log), "8"])
    try:
        while not (log.exists() and "START" in log.read_text(encoding="utf-8")):
            time.sleep(0.01)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
            for name, value in values.items():
                control.sendto(f"{name} {value}".encode(), ("127.0.0.1", port))
        while log.read_text(encoding="utf-8").count("CTL") < len(values):
            time.sleep(0.01)
        yield port
    finally:
        process.kill()
        process.wait()


def peer_truths(port: int) -> list[Truth]:
    """The independent frame at -117.3628 N and -0.4711 mm, by its three layouts."""

    def panel() -> tuple[str, str]:
        return "-117.363", "-0.4711"

    motion: Fields = {"kind": "input", "address": 4}
    low = {"kind": "input", "dtype": "f32", "words": "low_first"}
    high = {**low, "words": "high_first"}
    integer = {"kind": "input", "address": 10, "dtype": "i16", "scale": 0.1}
    long = {"kind": "input", "address": 12, "dtype": "i32", "words": "low_first", "scale": 0.0001}
    return [
        Truth("peer f32 low", port, _content("peer", {**low, "address": 0}, {**low, "address": 2}, motion), panel),
        Truth("peer f32 high", port, _content("peer", {**high, "address": 20}, {**high, "address": 22}, motion), panel),
        Truth("peer i16 i32", port, _content("peer", integer, long, motion), lambda: ("-117.4", "-0.4711")),
    ]


def wrong_maps(truths: Sequence[Truth], rng: random.Random, count: int) -> Iterator[Case]:
    """Wrong maps, the devices in turn; two cases of ten have two errors."""
    number = 0
    while number < count:
        truth = truths[number % len(truths)]
        content = copy.deepcopy(truth.content)
        kinds = rng.sample(list(ERRORS), 2 if rng.random() < 0.2 else 1)
        changed = True
        for kind in sorted(kinds, key=list(ERRORS).index):
            before = copy.deepcopy(content["points"])
            ERRORS[kind](content["points"], rng)
            changed = changed and content["points"] != before
        case = Case(truth, content, tuple(kinds))
        if changed and not case.is_right("as described") and _valid(content["points"]):
            number += 1
            yield case


def _valid(points: dict[str, Fields]) -> bool:
    return all(point["address"] >= 0 for point in points.values())


def _shift(points: dict[str, Fields], rng: random.Random) -> None:
    difference = rng.choice((1, -1))
    for point in points.values():
        point["address"] += difference


def _shift_one(points: dict[str, Fields], rng: random.Random) -> None:
    points[rng.choice(_MEASURED)]["address"] += rng.choice((1, -1))


def _numbered(points: dict[str, Fields], rng: random.Random) -> None:
    long, from_one = rng.random() < 0.4, rng.random() < 0.8
    for point in points.values():
        table = 4 if point["kind"] == "holding" else 3
        point["address"] += table * (100_000 if long else 10_000) + (1 if from_one or long else 0)


def _kind(points: dict[str, Fields], rng: random.Random) -> None:
    for point in points.values():
        point["kind"] = "holding" if point["kind"] == "input" else "input"


def _words(points: dict[str, Fields], rng: random.Random) -> None:
    for point in points.values():
        if point.get("dtype", "u16").endswith("32"):
            point["words"] = _OTHER[point.get("words", "high_first")]


def _bytes(points: dict[str, Fields], rng: random.Random) -> None:
    for name in _MEASURED:
        points[name]["byte_order"] = "low_first"


def _decimal(points: dict[str, Fields], rng: random.Random) -> None:
    point = points[rng.choice(_MEASURED)]
    point["scale"] = point.get("scale", 1.0) * 10.0 ** rng.choice((-3, -2, -1, 1, 2, 3))


def _binary(points: dict[str, Fields], rng: random.Random) -> None:
    point = points["force"]
    point["scale"] = point.get("scale", 1.0) * 2.0 ** -rng.choice((4, 8, 10, 12, 16))


def _sign(points: dict[str, Fields], rng: random.Random) -> None:
    points["force"]["scale"] = -points["force"].get("scale", 1.0)


def _signed(points: dict[str, Fields], rng: random.Random) -> None:
    for name in _MEASURED:
        dtype = points[name]["dtype"]
        points[name]["dtype"] = {"i16": "u16", "i32": "u32"}.get(dtype, dtype)


def _format(points: dict[str, Fields], rng: random.Random) -> None:
    point = points[rng.choice(_MEASURED)]
    point["dtype"] = rng.choice([dtype for dtype in ("i16", "i32", "f32", "f64", "u16", "u32") if dtype != point["dtype"]])


ERRORS: dict[str, Callable[[dict[str, Fields], random.Random], None]] = {
    "all addresses off by one": _shift,
    "one address off by one": _shift_one,
    "addresses from 30001, 300001": _numbered,
    "other function code": _kind,
    "other order of words": _words,
    "bytes swapped": _bytes,
    "scale by a power of ten": _decimal,
    "scale by a power of two": _binary,
    "sign": _sign,
    "unsigned instead of signed": _signed,
    "other number format": _format,
}
"""Changes of the points of a map by kind of error."""
