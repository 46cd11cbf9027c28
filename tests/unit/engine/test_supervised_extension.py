"""Supervision by the extension: sensors that freeze, coarse and slow sensors, and motion that is reported for ever."""

from __future__ import annotations

import itertools
import random
from dataclasses import replace

import pytest

from semlive.data.faults import FaultCode
from semlive.data.loading import DeviceIdentity

from .ramp_machine import DRIVE, LOAD, STIFFNESS, Machine, first_finding, stepped


@pytest.mark.parametrize("identity", [LOAD, DRIVE], ids=["load", "displacement"])
@pytest.mark.parametrize("sigma_mm", [0.0, 2e-5])
@pytest.mark.parametrize("rate_n_s", [5.0, 30.0])
def test_an_extension_that_freezes_in_a_ramp_is_found_within_three_seconds_or_30_n(
    identity: DeviceIdentity, sigma_mm: float, rate_n_s: float
) -> None:
    rng = random.Random(2)
    frozen_mm = 60.0 / STIFFNESS
    machine = Machine(rate_n_s=rate_n_s, shown=lambda force_n, t_s: force_n + rng.gauss(0.0, 0.05))
    machine.shown_mm = lambda mm: mm + rng.gauss(0.0, sigma_mm) if mm < frozen_mm else frozen_mm
    finding, true_n = first_finding(machine, identity, ordered_n_s=rate_n_s)
    assert finding is not None
    assert finding.code is FaultCode.FROZEN_READING
    assert true_n <= 60.0 + max(3.0 * rate_n_s, 30.0)


@pytest.mark.parametrize("identity", [LOAD, DRIVE], ids=["load", "displacement"])
@pytest.mark.parametrize("lsb_mm", [1e-5, 1e-4, 1e-3, 5e-3])
@pytest.mark.parametrize("sigma_mm", [0.0, 3e-5])
def test_a_coarse_extension_sensor_may_stand_still(identity: DeviceIdentity, lsb_mm: float, sigma_mm: float) -> None:
    rng = random.Random(4)
    machine = Machine(shown=lambda force_n, t_s: force_n + rng.gauss(0.0, 0.1))
    machine.shown_mm = lambda mm: stepped(lsb_mm)(mm + rng.gauss(0.0, sigma_mm))
    finding, true_n = first_finding(machine, identity)
    assert finding is None
    assert true_n == 300.0


@pytest.mark.parametrize("lsb_mm", [1e-5, 1e-3])
def test_a_coarse_extension_sensor_may_stand_still_after_a_soft_toe_region(lsb_mm: float) -> None:
    rng = random.Random(6)
    machine = Machine(shown=lambda force_n, t_s: force_n + rng.gauss(0.0, 0.1))
    # A tenth of the stiffness up to 60 N.
    machine.shown_mm = lambda mm: stepped(lsb_mm)(10.0 * mm if mm < 60.0 / STIFFNESS else mm + 9.0 * 60.0 / STIFFNESS)
    finding, true_n = first_finding(machine)
    assert finding is None
    assert true_n == 300.0


@pytest.mark.parametrize("every", [10, 40])
def test_a_slow_extension_sensor_may_stand_still(every: int) -> None:
    count, sampled = 0, 0.0

    def shown_mm(mm: float) -> float:
        nonlocal count, sampled
        count += 1
        sampled = mm if count % every == 0 else sampled
        return sampled

    finding, true_n = first_finding(Machine(shown_mm=shown_mm))
    assert finding is None
    assert true_n == 300.0


def test_an_extension_that_is_not_measured_or_never_changed_is_not_frozen() -> None:
    for identity in (LOAD, replace(LOAD, measures_extension=False)):
        finding, true_n = first_finding(Machine(shown_mm=lambda mm: 0.0), identity)
        assert finding is None
        assert true_n == 300.0


def test_motion_that_is_reported_for_ever_at_the_target_is_found_in_10_s_with_live_readings() -> None:
    rng = random.Random(8)
    seconds: list[float] = []

    def reports(moving: bool, t_s: float) -> bool:
        seconds.append(t_s)
        return t_s > 0.0

    machine = Machine(reports=reports, shown=lambda force_n, t_s: force_n + rng.gauss(0.0, 0.05))
    finding, _ = first_finding(machine, seconds=80.0)
    assert finding is not None
    assert finding.code is FaultCode.MOTION_OVERDUE
    assert 10.0 + 8.0 <= seconds[-1] <= 10.0 + 12.0


@pytest.mark.parametrize("creep_mm", [0.0, 1e-7])
def test_a_closed_loop_may_report_motion_for_some_seconds_at_its_target(creep_mm: float) -> None:
    rng = random.Random(8)
    machine = Machine(reports=lambda moving, t_s: 0.0 < t_s < 10.0 + 8.0, shown=lambda force_n, t_s: force_n + rng.gauss(0.0, 0.05))
    polls = itertools.count()
    # 0.04 N/s with 1e-7 mm from reading to reading.
    machine.shown_mm = lambda mm: mm + creep_mm * next(polls)
    assert first_finding(machine, seconds=80.0)[0] is None
