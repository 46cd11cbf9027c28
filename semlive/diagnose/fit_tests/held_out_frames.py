"""Fit of held-out frames with parameters from the other frames, and their residual in smooth shapes and in those of the effects."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.design_matrix import DesignMatrix
from semlive.diagnose.baseline.noise_scale import modes

Array = NDArray[np.float64]


DRAWS = 24


CHECKERBOARD_BLOCKS = 2  # edge of a field of the checkerboard in blocks, about 100 px


COARSE_POLYNOMIAL_ORDER = 2  # order of the polynomials in which the misfit is scored, in addition to the basis fields


FREE_PRIOR_PX, MIN_DRIFT_PX = 1e3, 1e-6


def held_out_residual(baseline: HyperparameterGrid, held_out: NDArray[np.bool_]) -> Array:
    """(h, b, 2) whitened residual of held-out frames; all parameters except the specimen motion are those of the other frames."""
    columns, data = baseline.design, baseline.whitened_residual[..., None]
    training_fit = _fit_training_frames(baseline, data, ~held_out, training_normal_matrix(columns, held_out))
    residual = data - columns.apply(training_fit.step)
    residual = residual - residual[~held_out].mean(axis=0)
    residuals = []
    for frame, rows, precision in _nuisance_rows(columns, training_fit, held_out):
        flat = rows.reshape(-1, rows.shape[-1])
        step = np.linalg.solve(flat.T @ flat + precision, flat.T @ residual[frame].reshape(len(flat), -1))
        residuals.append((residual[frame] - rows @ step)[..., 0])
    return np.stack(residuals)


def score_held_out_frames(
    baseline: HyperparameterGrid, shapes: DesignMatrix, held_out: NDArray[np.bool_], normal: Array, seed: int
) -> list[Array]:
    """Residual of the data and of noise draws, (n, 1 + draws), in the scored shapes, for each held-out frame.

    `normal` is the normal matrix of the training frames, of these columns and possibly of further columns after them.
    """
    columns = baseline.design
    f, b = columns.observation.frames, columns.observation.blocks
    noise = np.random.default_rng((seed, 42)).normal(size=(f, b, 2, DRAWS))
    data = np.concatenate((baseline.whitened_residual[..., None], noise - noise.mean(axis=0)), axis=-1)
    training_fit = _fit_training_frames(baseline, data, ~held_out, normal, seed)
    residual = data - columns.apply(training_fit.step)
    residual = residual - residual[~held_out].mean(axis=0)
    return _score_halves(columns, shapes, residual, training_fit, held_out)


@dataclass(frozen=True, slots=True, eq=False)
class _TrainingFit:
    """Result of the fit to the other pairs.

    Attributes:
        step: (p, k) parameters.
        spread: (r, r) covariance of the amplitudes of the effects.
        within_px: (f,) standard deviation of the drift change from the top to the bottom of each frame, px.
    """

    step: Array
    spread: Array
    within_px: Array


def training_normal_matrix(columns: DesignMatrix, held_out: NDArray[np.bool_]) -> Array:
    """(p, p) A^T A of the training frames, computed by subtracting the held-out frames."""
    f, b = columns.observation.frames, columns.observation.blocks
    normal = columns.normal_matrix.copy()
    for axis in (0, 1):
        frames = columns.columns[axis].reshape(f, b, -1)
        own, mean = frames[held_out].reshape(-1, frames.shape[-1]), frames[~held_out].mean(axis=0)
        normal[np.ix_(columns.index[axis], columns.index[axis])] -= own.T @ own + np.count_nonzero(~held_out) * (mean.T @ mean)
    return normal


def _fit_training_frames(
    baseline: HyperparameterGrid, data: Array, training: NDArray[np.bool_], normal: Array, seed: int = 0
) -> _TrainingFit:
    """Fit baseline and effects to the training frames of data (f, b, 2, 1 + draws): the measured data, then draws of noise.

    For a draw, the parameters are the errors of the fit, because the sampled values cancel in every residual.
    """
    columns, prior = baseline.design, baseline.best_prior
    f, b = columns.observation.frames, columns.observation.blocks
    gradient = np.zeros((columns.size, data.shape[-1]))
    for axis in (0, 1):
        own = columns.columns[axis].reshape(f, b, -1)[training].reshape(-1, columns.columns[axis].shape[1])
        observed = data[training, :, axis]
        gradient[columns.index[axis]] += own.T @ (observed - observed.mean(axis=0)).reshape(len(own), -1)
    first_solution = np.concatenate(
        (columns.observation.solution.mean[columns.parameter_indices], np.zeros(columns.size - len(columns.parameter_indices)))
    )
    gradient[:, 0] -= prior @ first_solution
    # Draws contain drift and distortion sampled from their priors, because the held-out frames do not determine these completely. Without
    # them a wrong row time with a log Bayes factor of 156 seemed to explain 14 % of its misfit, and was rejected.
    add_prior_draws(columns, prior, gradient[:, 1:], seed)
    factor = cho_factor(normal[: columns.size, : columns.size] + prior, lower=True, check_finite=False)
    last = np.eye(columns.size)[:, len(columns.parameter_indices) :]
    spread = np.asarray(cho_solve(factor, last))[len(columns.parameter_indices) :]
    rows = _drift_within(columns)
    within_px = np.sqrt(np.clip(np.sum(rows.T * cho_solve(factor, rows.T), axis=0), 0.0, None))
    return _TrainingFit(np.asarray(cho_solve(factor, gradient)), spread, within_px)


def add_prior_draws(columns: DesignMatrix, prior: Array, gradient: Array, seed: int) -> None:
    """Correct the gradient of draws (p, k) for the drift and distortion sampled from their priors."""
    for own in _sampled_parameters(columns):
        samples = np.random.default_rng((seed, 45, len(own))).normal(size=(len(own), gradient.shape[1]))
        gradient[own] -= np.linalg.cholesky(prior[np.ix_(own, own)]) @ samples


def _sampled_parameters(columns: DesignMatrix) -> list[NDArray[np.int64]]:
    """Parameters of the drift and of the distortion."""
    layout = columns.observation.state.layout
    parts = [layout.part(name) for name in ("drift", "distortion")]
    return [np.flatnonzero((columns.parameter_indices >= part.start) & (columns.parameter_indices < part.stop)) for part in parts]


def _drift_within(columns: DesignMatrix) -> Array:
    """(f, p) rows that give the drift change along x from the first block of each frame to its last."""
    observation = columns.observation
    state, time_s = observation.state, observation.geometry.time_s
    assert state.drift is not None  # there are pairs
    rows = np.zeros((observation.frames, columns.size))
    at = np.searchsorted(columns.parameter_indices, state.layout.part("drift").start + 2 * np.arange(state.drift.size // 2))
    rows[:, at] = state.drift.rows(time_s.max(axis=1)) - state.drift.rows(time_s.min(axis=1))
    return rows


def _nuisance_rows(columns: DesignMatrix, training_fit: _TrainingFit, held_out: NDArray[np.bool_]) -> Iterator[tuple[int, Array, Array]]:
    """For each held-out frame, rows (b, 2, n) of nuisance parameters and effects, and their prior precision (n, n)."""
    amplitude_precision = np.linalg.inv(training_fit.spread) if len(training_fit.spread) else training_fit.spread
    for frame, effect in zip(np.flatnonzero(held_out).tolist(), _effects_in(columns, held_out), strict=True):
        free, sizes_px = _nuisances(columns, frame, float(training_fit.within_px[frame]))
        rows = np.concatenate((free, effect), axis=-1)
        n = free.shape[-1]
        precision = np.zeros((rows.shape[-1],) * 2)
        precision[np.arange(n), np.arange(n)] = sizes_px**-2.0
        precision[n:, n:] = amplitude_precision
        yield frame, rows, precision


def _score_halves(
    columns: DesignMatrix, shapes: DesignMatrix, residual: Array, training_fit: _TrainingFit, held_out: NDArray[np.bool_]
) -> list[Array]:
    """For each held-out frame, (n, k) residual on each half of the field after fitting nuisance parameters on the other half."""
    board = _checkerboard(columns)
    scored = []
    for (frame, rows, precision), counted in zip(
        _nuisance_rows(columns, training_fit, held_out), _effects_in(shapes, held_out), strict=True
    ):
        fields = np.concatenate((smooth_columns(columns, frame), counted), axis=-1)
        for fitted in (board, ~board):
            on = rows[fitted].reshape(-1, rows.shape[-1])
            parameters = np.linalg.solve(on.T @ on + precision, on.T @ residual[frame][fitted].reshape(len(on), -1))
            misfit = (residual[frame] - rows @ parameters)[~fitted]
            basis = orthonormal_shapes(fields[~fitted])
            scored.append(basis.T @ misfit.reshape(len(basis), -1))
    return scored


def orthonormal_shapes(field: Array) -> Array:
    """(2 s, n) orthonormal columns that span fields (s, 2, q)."""
    flat = field.reshape(-1, field.shape[-1])
    size = np.sqrt(np.sum(flat**2, axis=0))
    vectors, values, _ = np.linalg.svd(flat[:, size > 1e-9 * size.max()] / size[size > 1e-9 * size.max()], full_matrices=False)
    return np.asarray(vectors[:, values > 1e-3 * values[0]])


def smooth_columns(columns: DesignMatrix, frame: int) -> Array:
    """(b, 2, q) whitened polynomials in one frame."""
    return _whitened(columns, frame, list(np.moveaxis(modes(columns.observation.geometry, COARSE_POLYNOMIAL_ORDER)[frame], -1, 0)))


def _effects_in(columns: DesignMatrix, held_out: NDArray[np.bool_]) -> Array:
    """(h, b, 2, r) whitened columns of the effects in held-out frames, minus their mean over the other frames."""
    f, b = columns.observation.frames, columns.observation.blocks
    r = len(columns.sizes_px)
    columns_xy = [column[:, column.shape[1] - r :].reshape(f, b, r) for column in columns.columns]
    field = np.stack(columns_xy, axis=2)
    return field[held_out] - field[~held_out].mean(axis=0)


def _nuisances(columns: DesignMatrix, frame: int, within_px: float) -> tuple[Array, Array]:
    """(b, 2, n) whitened columns and (n,) prior sizes: shift, undetermined drift within the frame, and gradient where it is free."""
    scene = columns.observation.geometry
    x, y = scene.x[frame], scene.y[frame]
    drift_px = max(within_px, MIN_DRIFT_PX) / float(np.ptp(y))
    shapes, sizes_px = [np.ones_like(x), y, y * y], [FREE_PRIOR_PX, drift_px, drift_px]
    if scene.steps.gradient_free[frame]:
        shapes, sizes_px = [*shapes, x], [FREE_PRIOR_PX, FREE_PRIOR_PX, drift_px, FREE_PRIOR_PX]
    return _whitened(columns, frame, shapes), np.repeat(sizes_px, 2)


def _whitened(columns: DesignMatrix, frame: int, shapes: list[Array]) -> Array:
    """(b, 2, 2 q) whitened shapes (b,) of one frame, along x and along y."""
    nothing = np.zeros_like(shapes[0])
    field = np.stack([np.stack(pair, axis=-1) for shape in shapes for pair in ((shape, nothing), (nothing, shape))], axis=-1)
    flat = solve_triangular(columns.whiten.factor, field.reshape(len(field), -1), lower=True) / columns.whiten.sigma_px
    white = np.asarray(flat).reshape(field.shape)
    if columns.whiten.over_frames is not None:  # correlation with the other frame of the pair is neglected here
        white = white * np.array([inverse[frame, frame] for inverse in columns.whiten.over_frames])[:, None]
    return white


def _checkerboard(columns: DesignMatrix) -> NDArray[np.bool_]:
    """(b,) True for blocks used in the fit."""
    observation = columns.observation
    row, column = np.divmod(observation.valid_blocks, observation.state.blocks.layout[1])
    return np.asarray((row // CHECKERBOARD_BLOCKS + column // CHECKERBOARD_BLOCKS) % 2 == 0, dtype=np.bool_)
