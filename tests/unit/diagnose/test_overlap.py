"""What one effect could take over of another, against the same in one dense matrix."""

from __future__ import annotations

import numpy as np
import pytest
from blind.experiment import Conditions
from blind.observing import QUICK, observed

from semlive.data.grid import Grid
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import overlap
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation

GRID = Grid(101, 101, 60, 12, 10, 43)


@pytest.fixture(scope="module")
def observation() -> Observation:
    return observed(Conditions(77, calibration=5, tension=2), (), GRID, QUICK)


@pytest.fixture(scope="module")
def ladder(observation: Observation) -> HyperparameterGrid:
    return noise_scaled_baseline(observation)


def columns(observation: Observation, name: str) -> np.ndarray:
    law = effect_class(name).basis_field(observation.geometry, {})
    assert law is not None
    return law.field_px


@pytest.fixture(scope="module")
def root(ladder: HyperparameterGrid) -> np.ndarray:
    """Root of I - A S A^T, the metric in which the baseline has been taken out."""
    count = len(ladder.design.columns[0])
    taken = np.zeros((2 * count, ladder.design.size))
    for axis in (0, 1):
        taken[axis * count : (axis + 1) * count, ladder.design.index[axis]] = ladder.design.columns[axis]
    metric = np.eye(len(taken)) - taken @ ladder.best.solve(taken.T)
    value, vector = np.linalg.eigh(0.5 * (metric + metric.T))
    return np.sqrt(np.clip(value, 0.0, None))[:, None] * vector.T


def dense(ladder: HyperparameterGrid, root: np.ndarray, field: np.ndarray, law: np.ndarray) -> float:
    """By generalised least squares."""
    both = np.concatenate((field[..., None], law), axis=-1)
    projected = root @ np.moveaxis(ladder.design.whiten(both), 2, 0).reshape(-1, 1 + law.shape[-1])
    fitted = projected[:, 1:] @ np.linalg.lstsq(projected[:, 1:], projected[:, 0], rcond=1e-5)[0]
    return float(fitted @ fitted / (projected[:, 0] @ projected[:, 0]))


@pytest.mark.parametrize("other", ["magnification_frame_instability", "aspect_drift", "tilt_with_load"])
def test_it_is_the_share_that_least_squares_gives(
    observation: Observation, ladder: HyperparameterGrid, root: np.ndarray, other: str
) -> None:
    field = columns(observation, "magnification_drift")[..., 0]
    law = columns(observation, other)
    assert overlap(ladder, field, law) == pytest.approx(dense(ladder, root, field, law), abs=1e-3)


def test_an_effect_takes_over_all_of_itself_and_nothing_of_what_is_in_another_direction(
    observation: Observation, ladder: HyperparameterGrid
) -> None:
    law = columns(observation, "tilt_with_load")
    assert overlap(ladder, law[..., 0], law) == pytest.approx(1.0)
    aside = np.zeros_like(law)
    aside[:, :, 0] = law[:, :, 0]
    only_x, only_y = aside[..., 0], law - aside
    assert overlap(ladder, only_x, only_y) < 0.05
