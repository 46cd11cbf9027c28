"""What is worked out of a stop before the run is what an independent machine does, for each fault: never farther, and not far from it."""

from __future__ import annotations

import inspect
import random
from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import ControlMode, DeviceIdentity
from semlive.engine.supervision import stop_distance
from semlive.engine.supervision.load_watch import LoadSupervisor
from semlive.engine.supervision.ramp_supervision import supervise
from semlive.engine.supervision.stop_distance import RampCase, StopDistance, exceeds, noticeable_n, stop_distances, worst
from semlive.service.device_link import DeviceLink
from semlive.service.device_link.stop_pursuit import DISOBEYED_S
from semlive_drivers.modbus.settings import ModbusSettings
from semlive_drivers.modbus.tcp.blind import CONNECT_S
from semlive_drivers.text.part import TextSettings

from .ramp_machine import DRIVE, LIMITS, LOAD, STIFFNESS, Machine, all_frozen_from, frozen_from

CASE = RampCase(LIMITS, start_n=0.0, target_n=300.0, rate_n_s=30.0, tolerance_n=3.0, poll_s=0.05)
DRIVEN = replace(CASE, control=ControlMode.DISPLACEMENT, stiffness_n_mm=STIFFNESS)
RATES = (2.0, 5.0, 30.0)


def row_of(case: RampCase, code: FaultCode, fault: str = "") -> StopDistance:
    (row,) = [item for item in stop_distances(case) if item.code is code and fault in item.fault]
    return row


@dataclass(frozen=True)
class Trial:
    """A machine with a fault, and the row that must bound it."""

    code: FaultCode
    machine: Callable[[float, float], Machine]
    fault: str = ""
    identity: DeviceIdentity = LOAD
    limits: Limits = LIMITS
    speed: float = 1.0
    from_start: bool = False


def dropping(at_n: float, drop_n: float) -> Machine:
    """A reading that is too low by `drop_n` from `at_n` on, and a device that goes by it."""
    machine = Machine(target_n=300.0 + drop_n, shown=lambda force_n, t_s: force_n - (drop_n if force_n > at_n else 0.0))
    return replace(machine)


def stuck_near(rate_n_s: float, at_n: float, *, extension: bool) -> Machine:
    machine = all_frozen_from(at_n / rate_n_s) if extension else Machine(ends=False, shown=frozen_from(at_n / rate_n_s))
    return replace(machine, rate_n_s=rate_n_s)


NEAR = "near the target"
SLACK = replace(LIMITS, slack_max_mm=0.004)
SCALED = replace(LIMITS, stiffness_min_n_mm=STIFFNESS)


def reading_a_part(rate_n_s: float, part: float) -> Machine:
    """A load cell that reads this part of the load, and a device that brings its reading to 300 N at the ordered rate."""
    return Machine(rate_n_s=rate_n_s / part, target_n=300.0 / part, shown=lambda force_n, t_s: part * force_n)


TRIALS = {
    "frozen": Trial(
        FaultCode.NO_RESPONSE, lambda rate, part: replace(Machine(ends=False, shown=frozen_from(part * 200 / rate)), rate_n_s=rate)
    ),
    "all frozen": Trial(FaultCode.NO_RESPONSE, lambda rate, part: stuck_near(rate, part * 200, extension=True)),
    "all frozen near": Trial(FaultCode.MOTION_OVERDUE, lambda rate, part: stuck_near(rate, 297.5 + 2 * part, extension=True), NEAR),
    "frozen near": Trial(FaultCode.MOTION_OVERDUE, lambda rate, part: stuck_near(rate, 297.5 + 2 * part, extension=False), NEAR),
    "runaway": Trial(FaultCode.OVERSHOOT, lambda rate, part: Machine(rate_n_s=rate, ends=False)),
    "too fast": Trial(FaultCode.RATE_NOT_KEPT, lambda rate, part: Machine(rate_n_s=20 * rate, ends=False), speed=20.0, from_start=True),
    "wrong sign": Trial(
        FaultCode.WRONG_DIRECTION, lambda rate, part: Machine(rate_n_s=rate, ends=False, shown=lambda force_n, t_s: -force_n)
    ),
    "drop": Trial(FaultCode.LOAD_JUMP, lambda rate, part: replace(dropping(150 + 140 * part, 19.0), rate_n_s=rate)),
    "drive frozen": Trial(
        FaultCode.TRAVEL_WITHOUT_LOAD, lambda rate, part: stuck_near(rate, 20 + part * 270, extension=False), "crosshead", identity=DRIVE
    ),
    "drive all frozen": Trial(FaultCode.NO_RESPONSE, lambda rate, part: stuck_near(rate, 20 + part * 270, extension=True), identity=DRIVE),
    "cell reads a small part": Trial(
        FaultCode.TRAVEL_WITHOUT_LOAD, lambda rate, part: reading_a_part(rate, part / 6), limits=SCALED, speed=20.0
    ),
    "cell reads nearly all": Trial(
        FaultCode.TRAVEL_WITHOUT_LOAD, lambda rate, part: reading_a_part(rate, 0.9 + 0.05 * part), limits=SCALED, speed=1.1
    ),
    "drive slack": Trial(FaultCode.LIMIT, lambda rate, part: stuck_near(rate, 20 + part * 270, extension=False), "crosshead", DRIVE, SLACK),
    "drive all frozen, slack": Trial(
        FaultCode.NO_RESPONSE, lambda rate, part: stuck_near(rate, 20 + part * 270, extension=True), "", DRIVE, SLACK
    ),
}


@pytest.mark.parametrize("name", TRIALS)
@pytest.mark.parametrize("poll_s", [0.05, 0.2])
def test_no_machine_goes_farther_than_its_row_reports(name: str, poll_s: float) -> None:
    trial = TRIALS[name]
    base = CASE if trial.identity is LOAD else DRIVEN
    nearest = 0.0
    for rate in RATES:
        case = replace(base, limits=trial.limits, rate_n_s=rate, poll_s=poll_s)
        row = row_of(case, trial.code, trial.fault)
        most_n = row.beyond_n if trial.from_start else row.worst_n
        assert most_n is not None
        for part in (0.3, 0.9):
            true_n = stopped_at(trial.machine(rate, part), trial, case)
            delivered_n = true_n + poll_s * rate * trial.speed
            assert delivered_n <= most_n + 1e-6, (rate, part)
            nearest = max(nearest, delivered_n / most_n)
    assert nearest > 0.6, "the row is much larger than the value of any machine"


def stopped_at(machine: Machine, trial: Trial, case: RampCase) -> float:
    """True load at the reading that stops it, by the supervision or by the watch of the limits; the end of the ramp if none does."""
    supervision, watch, true_n = supervise(case.limits, trial.identity), LoadSupervisor(), 0.0
    for true_n, sample, order in machine.samples(800.0 / case.rate_n_s + 60.0, case.poll_s):
        watch, sudden = watch.with_sample(case.limits, sample)
        supervision, finding = supervision.with_sample(sample)
        if finding is not None or sudden is not None:
            return true_n
        if order:
            supervision = supervision.ordered(case.target_n, case.rate_n_s, case.tolerance_n)
    return true_n


@pytest.mark.parametrize("sigma_n", [0.5, 2.0])
@pytest.mark.parametrize("identity", [LOAD, DRIVE], ids=["load", "displacement"])
def test_a_noisy_cell_that_saturates_goes_no_farther_than_its_row_reports(sigma_n: float, identity: DeviceIdentity) -> None:
    base = CASE if identity is LOAD else DRIVEN
    case = replace(base, tolerance_n=15.0, noticeable_n=noticeable_n(sigma_n, 0.0))
    code = FaultCode.NO_RESPONSE if identity is LOAD else FaultCode.TRAVEL_WITHOUT_LOAD
    trial = Trial(code, lambda rate, part: Machine(), identity=identity)
    row = row_of(case, code, "the force reading")
    for seed in range(5):
        rng = random.Random(seed)
        clipped = Machine(ends=False, shown=lambda force_n, t_s, rng=rng: min(force_n, 200.0) + rng.gauss(0.0, sigma_n))
        assert row.worst_n is not None
        assert row.beyond_n is not None
        true_n = stopped_at(clipped, trial, case) + 1.5
        assert true_n <= (200.0 + row.beyond_n if identity is LOAD else row.worst_n)


def test_a_limit_on_slack_below_the_noise_bounds_nothing() -> None:
    noisy = replace(DRIVEN, limits=SLACK, noticeable_n=12.0)
    row = row_of(noisy, FaultCode.LIMIT, "crosshead")
    assert row.worst_n is None
    assert "slack_force_n" in row.remark
    rng = random.Random(1)
    machine = Machine(ends=False, shown=lambda force_n, t_s: min(force_n, 200.0) + rng.gauss(0.0, 3.0))
    assert stopped_at(machine, Trial(FaultCode.LIMIT, lambda rate, part: machine, identity=DRIVE), noisy) > 1000.0


def test_without_a_stated_stiffness_nothing_bounds_a_cell_that_reads_a_part_of_the_load() -> None:
    for case in (CASE, DRIVEN):
        row = row_of(case, FaultCode.TRAVEL_WITHOUT_LOAD, "a part of the load")
        assert (row.beyond_n, row.worst_n) == (None, None)
        assert "limits.stiffness_min_n_mm" in row.remark
    trial = Trial(FaultCode.TRAVEL_WITHOUT_LOAD, lambda rate, part: Machine())
    assert stopped_at(reading_a_part(30.0, 0.1), trial, CASE) == 3000.0


def test_everything_at_rest_frozen_is_bounded_by_the_settle_time() -> None:
    row = row_of(CASE, FaultCode.STOPPED_EARLY)
    assert row.seconds == pytest.approx(5.0 + 0.1 + 0.1)
    assert row.worst_n == pytest.approx(30.0 * 5.2)
    small = row_of(replace(CASE, start_n=292.0), FaultCode.NOT_REACHED)
    assert small.seconds == pytest.approx(4 * 5.1 + 0.1)


def test_a_lost_link_ends_at_the_target_and_the_watchdog_bounds_it_sooner() -> None:
    silent, cut = (item for item in stop_distances(CASE) if item.code is FaultCode.LINK_LOST)
    assert silent.seconds == pytest.approx(0.05 + 0.3 + 0.3)
    assert silent.beyond_n == pytest.approx(30.0 * 0.65)
    assert (cut.beyond_n, cut.worst_n, cut.seconds) == (300.0, 300.0, 10.0)
    _, watched = (item for item in stop_distances(replace(CASE, watchdog_s=2.0)) if item.code is FaultCode.LINK_LOST)
    assert watched.beyond_n == pytest.approx(30.0 * 2.05)
    _, driven = (item for item in stop_distances(DRIVEN) if item.code is FaultCode.LINK_LOST)
    assert driven.beyond_n == pytest.approx(15.0)
    assert driven.travel_mm == pytest.approx(15.0 / STIFFNESS)


def test_nothing_bounds_a_device_that_does_not_obey_and_it_is_reported() -> None:
    row = row_of(CASE, FaultCode.STOP_NOT_OBEYED)
    assert (row.beyond_n, row.worst_n) == (None, None)
    assert "emergency stop" in row.remark


def test_the_worst_row_is_named_and_an_exceeded_limit_is_marked() -> None:
    rows = stop_distances(CASE)
    far = worst(rows, CASE)
    assert far is not None
    assert far.worst_n == max(row.worst_n for row in rows if row.worst_n is not None)
    assert not any(exceeds(row, CASE) for row in rows)
    hasty = replace(CASE, rate_n_s=200.0, poll_s=0.4)
    assert any(exceeds(row, hasty) for row in stop_distances(hasty))


def test_compression_is_the_mirror_image() -> None:
    down = replace(CASE, target_n=-300.0, limits=replace(LIMITS, force_min_n=-400.0, force_max_n=400.0))
    up = replace(CASE, limits=down.limits)
    assert [item.worst_n for item in stop_distances(down)] == [
        None if item.worst_n is None else -item.worst_n for item in stop_distances(up)
    ]
    assert [exceeds(item, down) for item in stop_distances(down)] == [exceeds(item, up) for item in stop_distances(up)]


def test_a_device_that_a_person_moves_has_no_rows() -> None:
    assert stop_distances(replace(CASE, control=ControlMode.MANUAL)) == ()
    assert worst((), CASE) is None


def test_the_times_are_those_of_link_and_drivers() -> None:
    assert inspect.signature(DeviceLink).parameters["dead_man_s"].default == stop_distance.DEAD_MAN_S
    assert stop_distance.STOP_REPORT_S == DISOBEYED_S
    assert stop_distance.CONNECT_S == CONNECT_S
    assert {ModbusSettings().timeout_s, TextSettings.model_fields["timeout_s"].default} == {stop_distance.ANSWER_S}
