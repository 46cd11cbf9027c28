"""Going to a load in displacement control, and numbers as devices keep them: pure."""

from __future__ import annotations

import itertools
import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from semlive.errors import LinkError
from semlive_drivers.load_approach import ApproachSettings, ApproachState, JogOrder, speed_problem, start, step
from semlive_drivers.modbus.codec import decode, encode
from semlive_drivers.modbus.registers import BitField, DType, Factor, Kind, RegisterPoint, WordOrder

SETTINGS = ApproachSettings(stiffness_n_mm=10_000.0, speed_max_mm_s=0.05, speed_min_mm_s=1e-4, arrived_n=1.0, travel_max_mm=1.0)
TURN_S = 0.1


def played(target_n: float, start_n: float, true_n_mm: float, rate_n_s: float = 50.0) -> tuple[list[float], ApproachState]:
    """Loads of a ramp on a spring, one for each turn, and how it ended."""
    at_mm = start_n / true_n_mm
    ramp, forces = start(target_n, rate_n_s, start_n, at_mm), [start_n]
    for _ in range(5000):
        ramp, go = step(ramp, SETTINGS, forces[-1], at_mm, TURN_S)
        if go is None:
            return forces, ramp
        assert go.speed_mm_s <= SETTINGS.speed_max_mm_s
        assert 0 < go.travel_mm <= SETTINGS.travel_max_mm
        at_mm += (1 if go.in_tension else -1) * min(go.travel_mm, go.speed_mm_s * TURN_S)
        forces.append(at_mm * true_n_mm)
    raise AssertionError("the ramp never ended")


@given(st.floats(-500, 500), st.floats(-500, 500), st.floats(0.3, 1.0))
def test_a_ramp_ends_at_its_target_never_turns_and_never_goes_faster(target_n: float, start_n: float, softer: float) -> None:
    true_n_mm = softer * SETTINGS.stiffness_n_mm
    forces, ramp = played(target_n, start_n, true_n_mm)
    assert ramp.finished
    assert not ramp.trouble
    assert abs(forces[-1] - target_n) <= SETTINGS.arrived_n
    steps = [after - before for before, after in itertools.pairwise(forces)]
    assert all(change * (target_n - start_n) >= 0 for change in steps)
    assert max((abs(change) / TURN_S for change in steps), default=0.0) <= 50.0 * 1.001


def test_a_specimen_that_is_far_softer_ends_the_ramp_by_its_way() -> None:
    _, ramp = played(500.0, 0.0, 100.0)
    assert "mm of travel brought the load to" in ramp.trouble


def test_a_load_that_goes_the_wrong_way_ends_the_ramp() -> None:
    ramp = start(100.0, 10.0, 0.0, 0.0)
    ramp, go = step(ramp, SETTINGS, -15.0, 0.001, TURN_S)
    assert go is not None
    ramp, go = step(ramp, SETTINGS, -21.0, 0.002, TURN_S)
    assert go is None
    assert "went from 0.0 to -21.0 N on its way to 100 N" in ramp.trouble
    assert step(ramp, SETTINGS, 50.0, 0.0, TURN_S) == (ramp, None)


def test_travel_is_computed_from_time_where_the_drive_reports_none() -> None:
    ramp = start(100.0, 10.0, 0.0, 0.0)
    for _ in range(3):
        ramp, go = step(ramp, SETTINGS, 0.0, 0.0, TURN_S)
        assert isinstance(go, JogOrder)
    assert ramp.travelled_mm == pytest.approx(2 * TURN_S * 10.0 / 10_000.0)  # nothing was ordered before the first reading


def test_numbers_as_devices_keep_them() -> None:
    swapped = RegisterPoint(Kind.HOLDING, 0, DType.F32, WordOrder.LOW_FIRST, byte_order=WordOrder.LOW_FIRST)
    assert decode(swapped, (0x0080, 0xC642)) == 99.25
    assert encode(swapped, 99.25) == (0x0080, 0xC642)
    assert decode(RegisterPoint(Kind.INPUT, 0, DType.I16, scale=0.1, offset=-40.0), (0xFFFF,)) == pytest.approx(-40.1)
    assert decode(RegisterPoint(Kind.INPUT, 0, first_bit=4, bit_count=3), (0b1011_0000,)) == 3
    weight = RegisterPoint(Kind.HOLDING, 0, DType.U32, sign=BitField("status", 7, 1), factors=(Factor(BitField("decimals", 0, 4)),))
    assert decode(weight, (0, 12345), {"status": (0x80,), "decimals": (0xF2,)}) == pytest.approx(-123.45)
    assert weight.needs == ("status", "decimals")
    with pytest.raises(LinkError, match="holds 32767, which is no reading"):
        decode(RegisterPoint(Kind.INPUT, 9, DType.I16, sentinels=(32767, -32768)), (32767,))
    with pytest.raises(LinkError, match="holds inf"):
        decode(RegisterPoint(Kind.INPUT, 9, DType.F32), (0x7F80, 0))
    assert math.isclose(
        decode(RegisterPoint(Kind.INPUT, 0, DType.F32), encode(RegisterPoint(Kind.INPUT, 0, DType.F32), 1e-3)), 1e-3, rel_tol=1e-7
    )


@given(st.floats(2.0, 5000.0), st.floats(5.0, 100.0), st.floats(0.02, 0.5), st.sampled_from([1.0, -1.0]))
def test_a_specimen_that_is_far_stiffer_than_stated_is_found_within_few_newtons(
    stiffer: float, rate_n_s: float, turn_s: float, sign: float
) -> None:
    """Stiffness in kN/mm in place of N/mm is a factor of 1000; the truth stays at most 100,000 N/mm."""
    true_n_mm = 20_000.0
    settings = ApproachSettings(stiffness_n_mm=true_n_mm / stiffer, speed_max_mm_s=1.0)
    at_mm, ramp = 0.0, start(sign * 300.0, rate_n_s, 0.0, 0.0)
    highest = 0.0
    while not ramp.finished:
        ramp, go = step(ramp, settings, at_mm * true_n_mm, at_mm, turn_s)
        if go is not None:
            at_mm += sign * min(go.travel_mm, go.speed_mm_s * turn_s)
        highest = max(highest, abs(at_mm) * true_n_mm)
    assert "stiffer than stiffness_n_mm" in ramp.trouble
    # One way of 0.5 um is 10 N here; what is allowed for noise is 5 N, and two readings must show it.
    assert highest < 3 * (10.0 + 5.0) * max(1.0, 1 / (1 - 1.5 / stiffer))


@given(st.integers(0, 1000), st.floats(0.0, 4.0))
def test_noise_is_not_taken_for_a_stiff_specimen(seed: int, noise_n: float) -> None:
    random_ = random.Random(seed)
    at_mm, ramp = 0.0, start(400.0, 50.0, random_.gauss(0.0, noise_n), 0.0, noise_n=3.0 * noise_n)
    for _ in range(5000):
        ramp, go = step(ramp, SETTINGS, at_mm * 9_000.0 + random_.gauss(0.0, noise_n), at_mm, TURN_S)
        if go is None:
            break
        at_mm += min(go.travel_mm, go.speed_mm_s * TURN_S)
    assert ramp.finished
    assert not ramp.trouble


def test_the_first_way_is_short_and_each_is_at_most_twice_the_one_before() -> None:
    at_mm, ramp, ways = 0.0, start(400.0, 200.0, 0.0, 0.0), []
    while not ramp.finished:
        ramp, go = step(ramp, SETTINGS, at_mm * 8_000.0, at_mm, TURN_S)
        if go is not None:
            ways.append(go.travel_mm)
            at_mm += min(go.travel_mm, go.speed_mm_s * TURN_S)
    assert ways[0] == SETTINGS.first_travel_mm
    assert all(later <= 2.0 * earlier for earlier, later in itertools.pairwise(ways))
    assert max(ways) == pytest.approx(200.0 / SETTINGS.stiffness_n_mm * SETTINGS.ahead_s)  # after some readings it is as ever


@pytest.mark.parametrize(
    ("rate_n_s", "step_mm_s", "sentence"),
    [
        (50.0, 0.0, None),
        (50.0, 0.005, None),
        (0.5, 0.0, "slower than speed_min_mm_s 0.0001; order at least 1 N/s"),
        (1000.0, 0.0, "faster than speed_max_mm_s 0.05; order at most 500 N/s"),
        (50.0, 0.003, "but the drive takes 0.003 mm/s; order a rate that is a multiple of 30 N/s"),
        (20.0, 0.003, "but the drive takes 0 mm/s"),
    ],
)
def test_a_rate_that_the_drive_cannot_keep_is_refused(rate_n_s: float, step_mm_s: float, sentence: str | None) -> None:
    problem = speed_problem(SETTINGS, rate_n_s, step_mm_s)
    assert problem is None if sentence is None else problem is not None and sentence in problem
