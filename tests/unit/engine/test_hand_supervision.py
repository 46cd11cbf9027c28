"""Supervision of a machine that a person moves: only a reading that does not follow the crosshead stops it."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from semlive.data.experiment import Limits
from semlive.data.faults import FaultCode
from semlive.data.loading import LoadSample, MotionState
from semlive.engine.supervision.operator_supervision import REACTION_S, HandSupervision
from semlive.engine.supervision.ramp_supervision import Finding

STIFFNESS_N_MM, RATE_N_S, TOLERANCE_N, ROW_S = 2000.0, 30.0, 3.0, 0.05
LIMITS = Limits(-50.0, 400.0, -1.0, 2.0, force_rate_max_n_s=200.0, force_step_max_n=400.0, stage_travel_um=200.0)


def pulled(shown: Callable[[float, float], float], to_n: float = 1000.0) -> tuple[Finding | None, float]:
    """What is found while a person pulls, and the true load in N then; `shown` gives the reading of a true load and of uniform noise."""
    rng, observed = random.Random(1), HandSupervision(LIMITS).ordered(RATE_N_S, TOLERANCE_N)
    for number in range(round(to_n / RATE_N_S / ROW_S)):
        time_ns, true_n = round(number * ROW_S * 1e9), number * ROW_S * RATE_N_S
        force_n = shown(true_n, rng.uniform(-0.1, 0.1))
        sample = LoadSample(number, time_ns, time_ns, force_n, true_n / STIFFNESS_N_MM, MotionState.MOVING, 300.0)
        observed, finding = observed.with_sample(sample)
        if finding is not None:
            return finding, true_n
    return None, to_n


def test_an_exactly_constant_reading_stops_a_manual_ramp_soon() -> None:
    finding, true_n = pulled(lambda true_n, noise_n: true_n + noise_n if true_n < 60.0 else 60.0)
    assert finding is not None
    assert finding.code is FaultCode.NO_RESPONSE
    assert true_n < 60.0 + 2.0 * 5.0 * TOLERANCE_N


def test_a_saturated_reading_with_noise_stops_a_person_in_time_to_react() -> None:
    finding, true_n = pulled(lambda true_n, noise_n: min(true_n, 200.0) + noise_n)
    assert finding is not None
    assert finding.code is FaultCode.TRAVEL_WITHOUT_LOAD
    assert true_n + REACTION_S * RATE_N_S <= LIMITS.force_max_n + TOLERANCE_N


@pytest.mark.parametrize("step_n", [0.0, 0.5, 3.0])
def test_a_reading_that_follows_stops_nobody(step_n: float) -> None:
    def shown(true_n: float, noise_n: float) -> float:
        return step_n * round((true_n + noise_n) / step_n) if step_n else true_n + noise_n

    assert pulled(shown, to_n=395.0)[0] is None


def test_pauses_and_returns_stop_nobody() -> None:
    observed = HandSupervision(LIMITS).ordered(RATE_N_S, TOLERANCE_N)
    for number, true_n in enumerate([*range(0, 200, 2), *[200] * 100, *range(200, 100, -2), *range(100, 300, 2)]):
        sample = LoadSample(
            number, number * 50_000_000, number * 50_000_000, float(true_n), true_n / STIFFNESS_N_MM, MotionState.MOVING, 300.0
        )
        observed, finding = observed.with_sample(sample)
        assert finding is None
