"""Coverage of stated intervals, short form: four experiments; docs/validation/estimation.md has the table over many more."""

from __future__ import annotations

import numpy as np
import pytest
from numexp.coverage import SMALL, Coverage, Normalised, coverages, normalised

EXPERIMENTS = 4
# Fractions within the stated 68 % over 90 experiments of other seeds, and how much one experiment's own fraction scatters about that
# (its errors hang together); four are believed within four standard errors.
USUAL = {
    "drift within frames": (0.76, 0.06),
    "distortion": (0.68, 0.10),
    "displacement of points": (0.687, 0.009),
    "mean strain": (0.75, 0.10),
    "strain of a gauge": (0.68, 0.02),
}


@pytest.fixture(scope="module")
def experiments() -> list[Normalised]:
    return [normalised(SMALL["correlated"], seed) for seed in range(1, 1 + EXPERIMENTS)]


@pytest.fixture(scope="module")
def found(experiments: list[Normalised]) -> dict[str, Coverage]:
    return {item.quantity: item for item in coverages(experiments)}


@pytest.mark.parametrize("quantity", USUAL)
def test_as_many_errors_are_inside_as_in_the_long_run(found: dict[str, Coverage], quantity: str) -> None:
    usual, scatter = USUAL[quantity]
    assert found[quantity].inside[0] == pytest.approx(usual, abs=4.0 * scatter / EXPERIMENTS**0.5)
    assert found[quantity].inside[1] > 0.85


@pytest.mark.parametrize("quantity", ["Young's modulus", "Poisson's ratio"])
def test_elastic_constants_err_by_what_is_stated(experiments: list[Normalised], quantity: str) -> None:
    """The mean square of four normal numbers is between 0.016 and 5.0 but once in a thousand times."""
    z = np.array([item[quantity][0] for item in experiments])
    assert 0.016 < np.mean(z**2) < 5.0


def test_a_coverage_counts_what_is_inside() -> None:
    rng = np.random.default_rng(1)
    (correct,) = coverages([{"a": rng.normal(size=(40, 2))} for _ in range(200)])
    assert correct.inside == pytest.approx((0.6827, 0.95), abs=0.02)
    assert correct.rms == pytest.approx(1.0, abs=0.03)
    (narrow,) = coverages([{"a": 2.0 * rng.normal(size=(40, 2)) + 0.5} for _ in range(200)])
    assert narrow.inside[0] < 0.45
    assert abs(narrow.bias - 0.5) < 5.0 * narrow.bias_error
    (empty,) = coverages([{"a": np.zeros((0, 2))}, {"a": rng.normal(size=(50, 2))}, {"a": rng.normal(size=(50, 2))}])
    assert np.isfinite(empty.rms)


def test_where_drift_wanders_errors_are_as_large_as_stated() -> None:
    """0.3 px rms with waves from four minutes on: believed to bend at random, drift and distortion erred by 1.2 of what was stated."""
    found = {item.quantity: item for item in coverages([normalised(SMALL["wander"], seed) for seed in range(1, 1 + EXPERIMENTS)])}
    for quantity in ("drift within frames", "distortion", "displacement of points", "strain of a gauge"):
        assert 0.4 < found[quantity].rms < 1.15, quantity
        assert found[quantity].inside[1] > 0.9, quantity
