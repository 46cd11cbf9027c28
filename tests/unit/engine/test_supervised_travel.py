"""A drive that jams or pauses, and a stated stiffness: supervision of a ramp by its travel."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from semlive.data.faults import FaultCode
from semlive.data.loading import DeviceIdentity

from .ramp_machine import DRIVE, LIMITS, LOAD, STIFFNESS, Machine, first_finding, stepped

SCALED = replace(LIMITS, stiffness_min_n_mm=0.5 * STIFFNESS)


def jammed_at(jam_n: float, until_s: float, sigma_n: float = 0.05, lsb_mm: float = 1e-6) -> Machine:
    """A drive that stops moving at a load until a time after the order, and reports motion."""
    rng = random.Random(9)
    machine = Machine(shown=lambda force_n, t_s: force_n + rng.gauss(0.0, sigma_n), reports=lambda moving, t_s: t_s > 0.0 and moving)
    machine.shown_mm = stepped(lsb_mm)

    def rate(force_n: float, t_s: float) -> float:
        machine.rate_n_s = 1e-9 if force_n >= jam_n and t_s < until_s else 30.0
        return force_n + rng.gauss(0.0, sigma_n)

    machine.shown = rate
    return machine


def test_a_displacement_drive_that_jams_is_found_in_six_seconds() -> None:
    times: list[float] = []
    machine = jammed_at(60.0, math.inf)
    inner = machine.shown
    machine.shown = lambda force_n, t_s: (times.append(t_s), inner(force_n, t_s))[1]
    finding, _ = first_finding(machine, DRIVE, seconds=30.0)
    assert finding is not None
    assert finding.code is FaultCode.NO_RESPONSE
    assert times[-1] <= 2.0 + 6.0


@pytest.mark.parametrize("pause_s", [1.0, 3.5])
def test_a_displacement_drive_may_pause(pause_s: float) -> None:
    finding, true_n = first_finding(jammed_at(60.0, 2.0 + pause_s), DRIVE)
    assert finding is None
    assert true_n == 300.0


def test_a_coarse_sensor_gives_a_displacement_drive_more_time() -> None:
    coarse = jammed_at(60.0, 2.0 + 7.0, lsb_mm=1e-3)
    finding, true_n = first_finding(coarse, DRIVE)
    assert finding is None
    assert true_n == 300.0


@pytest.mark.parametrize("identity", [LOAD, DRIVE], ids=["load", "displacement"])
@pytest.mark.parametrize("part", [0.05, 0.1, 0.3])
def test_a_cell_that_reads_a_part_of_the_load_is_found_where_the_stiffness_is_stated(identity: DeviceIdentity, part: float) -> None:
    rng = random.Random(10)
    # The device follows the reading in load control; a displacement drive keeps its speed.
    faster = 1.0 / part if identity is LOAD else 1.0
    machine = Machine(rate_n_s=30.0 * faster, target_n=300.0 / part, shown=lambda force_n, t_s: part * force_n + rng.gauss(0.0, 0.05))
    finding, true_n = first_finding(machine, identity, limits=SCALED)
    assert finding is not None
    assert finding.code is FaultCode.TRAVEL_WITHOUT_LOAD
    assert true_n <= 1.05 * LIMITS.force_max_n


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("identity", [LOAD, DRIVE], ids=["load", "displacement"])
def test_a_stated_stiffness_stops_no_healthy_ramp(seed: int, identity: DeviceIdentity) -> None:
    rng = random.Random(100 + seed)
    sigma_n, lsb_mm, slack_mm = rng.choice([0.05, 0.5, 1.0]), rng.choice([1e-6, 1e-4, 1e-3]), rng.choice([0.0, 1.0])
    toe_n = rng.choice([0.0, 15.0])
    # Slack before the first load, then a quarter of the stiffness up to the toe load.
    toe_mm, soft_mm = toe_n / STIFFNESS, 4.0 * toe_n / STIFFNESS
    machine = Machine(shown=lambda force_n, t_s: force_n + rng.gauss(0.0, sigma_n))
    machine.shown_mm = lambda mm: stepped(lsb_mm)(slack_mm + (4.0 * mm if mm < toe_mm else mm - toe_mm + soft_mm) if mm > 0 else 0.0)
    finding, true_n = first_finding(machine, identity, limits=SCALED, tolerance_n=6.0)
    assert finding is None
    assert true_n == 300.0
