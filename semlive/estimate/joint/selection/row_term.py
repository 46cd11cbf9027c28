"""Test for row shifts: scatter of the residuals of row groups along x beyond their noise and beyond their scatter along y."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import TermTest
from semlive.estimate.joint.observations.state import EstimatorState, MapObservations
from semlive.estimate.joint.selection.marginal_likelihood import LINE_CANDIDATES
from semlive.estimate.joint.selection.model_selection import MIN_BAYES_FACTOR
from semlive.model import UniformSpline

Field = NDArray[np.float64]


def row_groups(state: EstimatorState) -> UniformSpline:
    """Linear spline over the rows of a frame with segments of one subset edge.

    A subset averages over its rows, so shorter changes are not observable.
    """
    count = max(1, math.ceil((state.height_px - 1) / max(state.grid.subset_px, state.grid.step_px)))
    return UniformSpline(0.0, (state.height_px - 1) / count, count, 1)


def row_shift_term_test(state: EstimatorState, misfit: Sequence[Field], noise_scale: float) -> tuple[TermTest, float]:
    """Test for row shifts and estimate their most likely size, px.

    Blocks side by side contain the same rows, so their mean residual is the row shift plus noise. Drift and distortion absorb a part of the
    shifts, which makes the test conservative. A drift faster than its knots appears along y as well.

    Args:
        state: the data.
        misfit: residual (blocks, 2) of each map from frame 0 or within a pair that has weight, px, in the order of the rows of the state.
        noise_scale: noise scale of the data.
    """
    used_rows = [rows for rows in state.rows if rows.weight.any()]
    of_x, of_y = ([_of_rows(state, rows, residual, axis) for rows, residual in zip(used_rows, misfit, strict=True)] for axis in (0, 1))
    (mean, weight), (mean_y, other_weight) = (tuple(np.concatenate(value) for value in zip(*both, strict=True)) for both in (of_x, of_y))
    gain = _gains(mean, weight * noise_scale**-2.0)
    gains_y = _gains(mean_y, other_weight * noise_scale**-2.0)
    best = int(np.argmax(gain))
    more = float(gain[best] - max(float(gains_y.max()), 0.0))
    z = mean * np.sqrt(weight) / noise_scale
    return TermTest("line_shift", more > MIN_BAYES_FACTOR, float(np.mean(z**2)), more), float(LINE_CANDIDATES[best])


def _of_rows(state: EstimatorState, rows: MapObservations, residual: Field, axis: int) -> tuple[Field, Field]:
    """Weighted mean and its weight for every observed row of blocks of one map."""
    shape = state.blocks.layout
    weight = rows.weight[:, axis].reshape(shape)
    total = weight.sum(axis=1)
    used = total > 0
    return (weight * residual[:, axis].reshape(shape)).sum(axis=1)[used] / total[used], total[used]


def _gains(mean: Field, weight: Field) -> Field:
    """Log likelihood gain of each candidate scatter for means of known weight."""
    more = LINE_CANDIDATES[:, None] ** 2 * weight
    return 0.5 * (mean**2 * weight * more / (1.0 + more) - np.log1p(more)).sum(axis=1)
