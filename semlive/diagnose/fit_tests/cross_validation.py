"""Cross-validation: the part of the misfit explained by effects in pairs excluded from the fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import HeldOutMisfit
from semlive.diagnose.baseline.baseline import HyperparameterGrid, point_like
from semlive.diagnose.fit_tests.held_out_frames import (
    DRAWS,
    add_prior_draws,
    orthonormal_shapes,
    score_held_out_frames,
    smooth_columns,
    training_normal_matrix,
)

Array = NDArray[np.float64]
FOLDS = 4  # every pair except the first, the reference of all others, is held out once
BOOTSTRAP_DRAWS = 400
MIN_PREDICTED_CHI2 = 9.0  # squared prediction of the effects in held-out frames, in units of the noise


def held_out_misfit(without: HyperparameterGrid, baseline_with_effects: HyperparameterGrid, seed: int) -> HeldOutMisfit:
    """Misfit of held-out pairs without and with the additional effects of the second grid.

    Amplitudes and baseline are fitted to the other pairs. In held-out frames only the motion of the specimen and the drift within the frame
    are fitted, on half of the field; the other half is scored, and vice versa. Amplitudes that occur only in held-out frames are fitted
    there too. Both baselines have the smoothness of the second, because a rougher drift would absorb a part of the effect. The misfit is
    measured in smooth shapes and in the shapes of the effects. The remainder is noise, which at four times the smallest detectable effect
    is a hundred times larger than the misfit. The noise floor and its scatter follow from draws of noise, drift and distortion.
    """
    without = point_like(without.design, baseline_with_effects)
    before, after = _held_out_scores(without, baseline_with_effects, seed)
    if _predicted(before, after) < MIN_PREDICTED_CHI2:
        before, after = _fit_scores(without, baseline_with_effects, seed)
    before_power, after_power = (np.array([float(np.mean(value[:, 0] ** 2)) for value in scored]) for scored in (before, after))
    weight = np.array([float(len(value)) for value in before])
    floors = np.average([np.mean(value[:, 1:] ** 2, axis=0) for value in after], axis=0, weights=weight)
    noise, residual = float(floors.mean()), float(np.average(before_power, weights=weight))
    rng = np.random.default_rng((seed, 43))
    closures = []
    for _ in range(BOOTSTRAP_DRAWS):
        samples = rng.integers(0, len(before_power), len(before_power))
        gained = float(np.average(before_power[samples] - after_power[samples], weights=weight[samples]))
        closures.append(_closure(gained, residual - float(rng.choice(floors)), noise))
    low, high = (float(value) for value in np.quantile(closures, (0.025, 0.975)))
    sigma_px = without.design.whiten.sigma_px
    sizes = [sigma_px * float(np.sqrt(value)) for value in (residual, np.average(after_power, weights=weight), noise)]
    gain = float(np.sum(weight * (before_power - after_power)))
    # With a prediction g and noise n the gain is g^2 + 2 g n, with standard deviation 2 |g|; if g is absent in the data it is 2 g n - g^2.
    gain_in_sigmas = gain / (2.0 * float(np.sqrt(max(_predicted(before, after), 1e-12))))
    closure = _closure(gain / float(weight.sum()), residual - noise, noise)
    return HeldOutMisfit(sizes[0], sizes[1], sizes[2], closure, (low, high), gain_in_sigmas, 0.5 * gain)


def explained_fraction_of_truth(without: HyperparameterGrid, baseline_with_effects: HyperparameterGrid, true_px: Array, seed: int) -> float:
    """Explained fraction relative to the same data without the hidden displacement (f, b, 2) px; for benchmarks.

    The noise floor is the misfit of the data without the effects, so noise does not contribute.
    """
    without_hidden = point_like(
        replace(without.design, observation=replace(without.design.observation, disparity_px=true_px)), baseline_with_effects
    )
    without = point_like(without.design, baseline_with_effects)
    before, after = _held_out_scores(without, baseline_with_effects, seed)
    floor = _held_out_scores(without_hidden, baseline_with_effects, seed)[0]
    if _predicted(before, after) < MIN_PREDICTED_CHI2:
        before, after = _fit_scores(without, baseline_with_effects, seed)
        floor = _fit_scores(without_hidden, baseline_with_effects, seed)[0]
    before_power, after_power, floor_power = (sum(float(np.sum(value[:, 0] ** 2)) for value in scored) for scored in (before, after, floor))
    return (before_power - after_power) / (before_power - floor_power)


def _predicted(before: list[Array], after: list[Array]) -> float:
    """Squared prediction of the effects in the scored shapes, in units of the noise."""
    return sum(float(np.sum((value[:, 0] - with_effects[:, 0]) ** 2)) for value, with_effects in zip(before, after, strict=True))


def _held_out_scores(without: HyperparameterGrid, baseline_with_effects: HyperparameterGrid, seed: int) -> tuple[list[Array], list[Array]]:
    """Residual of each frame without and with the effects, with amplitudes fitted to the other pairs."""
    pair = without.design.observation.geometry.pair
    order = np.searchsorted(np.unique(pair), pair)
    before, after = [], []
    for fold in range(FOLDS):
        held_out = np.asarray((order > 0) & (order % FOLDS == fold), dtype=np.bool_)
        if held_out.any():
            normal = training_normal_matrix(baseline_with_effects.design, held_out)
            before += score_held_out_frames(without, baseline_with_effects.design, held_out, normal, seed)
            after += score_held_out_frames(baseline_with_effects, baseline_with_effects.design, held_out, normal, seed)
    return before, after


def _fit_scores(without: HyperparameterGrid, baseline_with_effects: HyperparameterGrid, seed: int) -> tuple[list[Array], list[Array]]:
    """Residual of the fit itself, without held-out frames. A jump shifts frames, and the shift of held-out frames is free."""
    columns = baseline_with_effects.design
    residuals = [without.residual(), baseline_with_effects.residual()]
    noise = _draw_residuals(baseline_with_effects, seed)
    scores: tuple[list[Array], list[Array]] = ([], [])
    f, b = columns.observation.frames, columns.observation.blocks
    r = len(columns.sizes_px)
    own = np.stack([column[:, column.shape[1] - r :].reshape(f, b, r) for column in columns.columns], axis=2)
    for frame in range(f):
        basis = orthonormal_shapes(np.concatenate((smooth_columns(columns, int(frame)), own[frame]), axis=-1))
        for residual, scored in zip(residuals, scores, strict=True):
            scored.append(basis.T @ np.concatenate((residual[frame][..., None], noise[frame]), axis=-1).reshape(len(basis), -1))
    return scores


def _draw_residuals(baseline_with_effects: HyperparameterGrid, seed: int) -> Array:
    """(f, b, 2, draws) residual of the fit for draws of noise, drift and distortion from their priors."""
    columns, rng = baseline_with_effects.design, np.random.default_rng((seed, 44))
    noise = rng.normal(size=(columns.observation.frames, columns.observation.blocks, 2, DRAWS))
    noise -= noise.mean(axis=0)
    gradient = columns.transposed(noise)
    add_prior_draws(columns, baseline_with_effects.best_prior, gradient, seed)
    return noise - columns.apply(baseline_with_effects.best.solve(gradient))


def _closure(gained: float, gap: float, noise: float) -> float:
    """Explained fraction.

    The misfit is at least the gain: at twice the smallest detectable effect the noise scatters by more than the misfit.
    """
    return gained / max(gap, gained, 1e-3 * noise)
