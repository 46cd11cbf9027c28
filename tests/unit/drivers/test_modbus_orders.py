"""Orders as requests: which registers are written, and which values are refused because the device would not hold them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from semlive.errors import BadConfig, LinkError
from semlive_drivers.modbus.codec import Block, decode
from semlive_drivers.modbus.device_map import Write
from semlive_drivers.modbus.orders.requests import Request, encoded, requests_of, runs_of
from semlive_drivers.modbus.registers import DType, Kind, RegisterPoint
from semlive_drivers.order_exactness import require_exact, towards_zero

SCALED = {
    "target": RegisterPoint(Kind.HOLDING, 10, DType.I16, scale=0.1),
    "rate": RegisterPoint(Kind.HOLDING, 12, scale=0.1),
    "command": RegisterPoint(Kind.HOLDING, 14),
}
RAMP = Write(set={"target": "force_n", "rate": "rate_n_s", "command": 1})


def test_registers_that_the_map_does_not_name_are_not_written() -> None:
    requests = requests_of(RAMP, SCALED, {"force_n": 300.0, "rate_n_s": 30.0})
    assert requests == [
        Request(Block(Kind.HOLDING, 10, 1), (3000,), ("target",)),
        Request(Block(Kind.HOLDING, 12, 1), (300,), ("rate",)),
        Request(Block(Kind.HOLDING, 14, 1), (1,), ("command",)),
    ]


def test_adjacent_registers_are_one_request_in_whatever_order_they_are_named() -> None:
    points = {
        "command": RegisterPoint(Kind.HOLDING, 4),
        "rate": RegisterPoint(Kind.HOLDING, 2, DType.F32),
        "target": RegisterPoint(Kind.HOLDING, 0, DType.F32),
    }
    assert runs_of(points) == [("target", "rate", "command")]
    assert runs_of({**points, "enable": RegisterPoint(Kind.COIL, 5)}) == [("target", "rate", "command"), ("enable",)]


@given(st.lists(st.integers(0, 40), unique=True, min_size=1, max_size=12))
def test_every_named_register_is_written_once_and_the_last_named_one_in_the_last_request(addresses: list[int]) -> None:
    points = {f"p{address}": RegisterPoint(Kind.HOLDING, address) for address in addresses}
    requests = requests_of(Write(set=dict.fromkeys(points, 7)), points, {})
    written = [address for request in requests for address in range(request.block.address, request.block.address + request.block.count)]
    assert sorted(written) == sorted(addresses)
    assert f"p{addresses[-1]}" in requests[-1].names
    assert all(request.registers == (7,) * request.block.count for request in requests)


def test_two_points_in_one_register_are_refused() -> None:
    with pytest.raises(BadConfig, match="lie in the same register 3"):
        runs_of({"one": RegisterPoint(Kind.HOLDING, 2, DType.F32), "other": RegisterPoint(Kind.HOLDING, 3)})


@pytest.mark.parametrize(
    ("force_n", "rate_n_s", "sentence"),
    [
        (300.0, 0.04, r"0.04 N/s is less than one count of rate \(holding register 12\)"),
        (300.0, 1.04, r"1.04 N/s would be sent to rate \(holding register 12\) as 1; order a value that the device can hold"),
        (3500.0, 30.0, "3500 does not fit into register 10"),
        (300.0, 7000.0, "7000 does not fit into register 12"),
        (0.03, 30.0, "0.03 N is less than one count of target"),
        (3.04, 30.0, "3.04 N would be sent to target .* as 3;"),
        (float("nan"), 30.0, "does not fit into register 10"),
    ],
)
def test_a_value_that_the_device_would_not_take_as_it_is_meant_is_refused(force_n: float, rate_n_s: float, sentence: str) -> None:
    with pytest.raises(LinkError, match=sentence):
        requests_of(RAMP, SCALED, {"force_n": force_n, "rate_n_s": rate_n_s})


@pytest.mark.parametrize(("force_n", "rate_n_s"), [(300.04, 30.0), (0.0, 0.1), (-12.5, 10.05), (1e-6 + 3.0, 200.0)])
def test_a_value_within_one_percent_is_sent(force_n: float, rate_n_s: float) -> None:
    assert len(requests_of(RAMP, SCALED, {"force_n": force_n, "rate_n_s": rate_n_s})) == 3


def test_a_stop_is_not_refused_for_the_numbers_it_repeats() -> None:
    stop = Write(set={"target": "force_n", "rate": "rate_n_s", "command": 2})
    assert len(requests_of(stop, SCALED, {"force_n": 0.03, "rate_n_s": 0.04}, exact=False)) == 3


@given(st.floats(0.0101, 600.0))
def test_a_speed_or_a_travel_is_never_sent_larger_than_it_is_meant(value: float) -> None:
    point = RegisterPoint(Kind.HOLDING, 0, scale=0.01)
    for name in ("speed_mm_s", "travel_mm"):
        sent = decode(point, encoded("p", point, name, {name: value}))
        assert 0 < sent <= value * (1 + 1e-6)
        assert value - sent < 0.01 * (1 + 1e-6)


def test_rounding_errors_do_not_lose_a_count() -> None:
    assert towards_zero(0.0007 / 0.0001) == 7
    assert towards_zero(-6.9) == -6


def test_a_float_too_small_for_its_format_is_refused() -> None:
    point = RegisterPoint(Kind.HOLDING, 0, DType.F32)
    with pytest.raises(LinkError):
        encoded("rate", point, "rate_n_s", {"rate_n_s": 1e-50})
    with pytest.raises(LinkError):
        encoded("rate", point, "rate_n_s", {"rate_n_s": 1e-40})
    with pytest.raises(LinkError, match="does not fit"):
        encoded("rate", point, "rate_n_s", {"rate_n_s": 1e40})


def test_a_watchdog_time_may_differ_by_a_tenth() -> None:
    require_exact("watchdog_s", 1.55, 1.6, "watchdog")
    with pytest.raises(LinkError, match=r"0.16 s would be sent to watchdog as 0.2"):
        require_exact("watchdog_s", 0.16, 0.2, "watchdog", "s")
