"""Priors of the drift with additional courses: positive definite, also after pauses much longer than a frame."""

from __future__ import annotations

import numpy as np
import pytest
from blind.experiment import Conditions
from blind.observing import observed

from semlive.data.grid import Grid
from semlive.diagnose.baseline.design_matrix import design
from semlive.diagnose.baseline.noise_scale import most_likely_whitener
from semlive.diagnose.baseline.priors import with_covariance, with_terms
from semlive.errors import IllPosed

GRID = Grid(101, 101, 60, 13, 10, 43)


@pytest.mark.parametrize(("pause_s", "seed"), [(1000.0, 3), (3000.0, 1)])
def test_every_prior_of_a_run_with_pauses_is_positive_definite(pause_s: float, seed: int) -> None:
    observation = observed(Conditions(seed, calibration=5, tension=0, pause_s=pause_s), (), GRID)
    priors = design(observation, most_likely_whitener(observation)).priors
    different = priors.different()
    assert any(drift.relaxation_px for drift in different)
    for drift in different:
        assert np.isfinite(priors.prior(drift, 1.0).half_log_det)


def test_terms_are_a_covariance_of_few_columns() -> None:
    rng = np.random.default_rng(5)
    columns, terms = rng.normal(size=(30, 12)), rng.normal(size=(12, 3))
    precision = columns.T @ columns
    added = with_terms(precision, terms)
    np.testing.assert_allclose(added, np.linalg.inv(np.linalg.inv(precision) + terms @ terms.T), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(added, with_covariance(precision, terms @ terms.T), rtol=1e-9, atol=1e-9)


def test_a_precision_that_is_indefinite_is_refused() -> None:
    with pytest.raises(IllPosed, match="singular"):
        with_terms(np.diag([1.0, -1.0]), np.ones((2, 1)))
