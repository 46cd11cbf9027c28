"""Test of the time course of identified effects: the same spatial shape with another course over the frames.

An effect with an amplitude for every pair fits any field of its shape without residual. With `magnification_drift` removed from the
dictionary, a slow drift was identified as `refocus_magnification_step`, a magnification jump at every step.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid, point_like
from semlive.diagnose.baseline.bayes_factor import information, log_factor
from semlive.diagnose.baseline.design_matrix import BaselineEffect, DesignMatrix
from semlive.diagnose.maps.refinement import RefinedEffect
from semlive.model.effects import RunGeometry
from semlive.model.effects.run_geometry import slow_gaussian_process

Array = NDArray[np.float64]

SIZES_PX = np.geomspace(3e-4, 3.0, 12)
FRAME_SHIFT_PX = 1.0  # prior standard deviation of a common shift of a frame, as by jumps and drift
MIN_SHAPE_FRACTION = 0.9  # of the power of an effect in one spatial shape; otherwise the test does not apply
# A real time course may fit better than that of the basis field by this fraction of the gain of the shape: 6 of 190 for a charged spot of
# eight times the smallest detectable size.
TOLERATED_GAIN_FRACTION = 0.03
SHORT_CORRELATION_FRACTION = 0.15  # correlation time of the faster random time course, as a fraction of the run


def alternative_time_course_odds(
    baseline_with_effects: HyperparameterGrid, baseline: DesignMatrix, effects: Sequence[RefinedEffect]
) -> float:
    """Largest log odds, over all effects, for another time course of an effect's shape against the time course of its basis field.

    Args:
        baseline_with_effects: the baseline with the effects. Its smoothness must be selected with the effects in the model: a smoothness
            selected without them absorbs a part of the effects and changes the residual time course. For a wrong row time this
            gave a log odds of 17 instead of -0.1.
        baseline: the columns of the baseline without the effects.
        effects: the effects; each is tested with the others in the baseline.
    """
    return max(
        (
            _alternative_odds(baseline_with_effects, baseline, effect, [retained for retained in effects if retained is not effect])
            for effect in effects
        ),
        default=-np.inf,
    )


def _alternative_odds(
    baseline_with_effects: HyperparameterGrid, columns: DesignMatrix, effect: RefinedEffect, retained_effects: Sequence[RefinedEffect]
) -> float:
    shape, share = _shape(effect)
    if share < MIN_SHAPE_FRACTION:
        return -np.inf
    own_course = _own_course(effect, shape)
    for effect_in_baseline in (
        *(retained.baseline_effect for retained in retained_effects),
        _remaining_field(columns, effect, shape, own_course),
    ):
        columns = columns.with_effects(effect_in_baseline)
    base = point_like(columns, baseline_with_effects)
    normal, gradient = _of_frames(base, shape)
    own = _course_evidence(normal, gradient, own_course)
    return max(_gain(_course_evidence(normal, gradient, course), own) for course in _courses(base.design.observation.geometry))


def _gain(alternative: tuple[float, float], own: tuple[float, float]) -> float:
    """Log odds for the alternative time course; a small gain of its fit is tolerated."""
    tolerated = np.clip(alternative[1] - own[1], 0.0, TOLERATED_GAIN_FRACTION * max(own[1], 0.0))
    return float(alternative[0] - own[0] - tolerated)


def _of_frames(base: HyperparameterGrid, shape: Array) -> tuple[Array, Array]:
    """(f, f) information on the amplitude of a shape in each frame, and (f,) gradient, after marginalising a shift of each frame."""
    f = base.design.observation.frames
    field = np.zeros((f, *shape.shape, 3, f))
    for place, value in enumerate((shape, (1.0, 0.0), (0.0, 1.0))):
        field[np.arange(f), :, :, place, np.arange(f)] = value
    (normal,), (gradient,) = information(base, field.reshape(*field.shape[:3], 3 * f))
    projected = np.linalg.solve(normal[f:, f:] + np.eye(2 * f) / FRAME_SHIFT_PX**2, np.column_stack((normal[f:, :f], gradient[f:])))
    return normal[:f, :f] - normal[:f, f:] @ projected[:, :f], gradient[:f] - normal[:f, f:] @ projected[:, f]


def _shape(effect: RefinedEffect) -> tuple[Array, float]:
    """(b, 2) main spatial shape of an effect without translations, which are drift, and the fraction of the power in it."""
    moved = effect.field_px @ effect.amplitudes
    bent = moved - moved[0]
    bent = bent - bent.mean(axis=1, keepdims=True)
    _, size, shapes = np.linalg.svd(bent.reshape(len(bent), -1), full_matrices=False)
    shape = shapes[0].reshape(bent.shape[1:])
    return shape / np.sqrt(np.mean(np.sum(shape**2, axis=-1))), float(size[0] ** 2 / np.sum(size**2)) if size[0] > 0.0 else 0.0


def _own_course(effect: RefinedEffect, shape: Array) -> Array:
    """(f, q) amplitude of the shape in each frame, for each column of the basis field."""
    bent = effect.field_px - effect.field_px.mean(axis=1, keepdims=True)
    return np.einsum("fbcq,bc->fq", bent, shape) / np.sum(shape**2)


def _remaining_field(columns: DesignMatrix, effect: RefinedEffect, shape: Array, course: Array) -> BaselineEffect:
    """The part of the basis field outside the shape, with a free time course.

    An oscillation with a period of two frame times has two shapes, one of them with 96 % of the power. Without the second shape in the
    baseline, its residual appeared in the time course, with log odds of 72 at eight times the smallest detectable size; with it, -13.
    """
    return BaselineEffect(
        columns.whiten(effect.field_px - shape[None, :, :, None] * course[:, None, None, :]), effect.baseline_effect.size_px
    )


def _courses(scene: RunGeometry) -> tuple[Array, ...]:
    """Columns (f, q) of random time courses: slow, faster, per pair, per frame, powers of time, alternating, and with the load."""
    f, at_s = len(scene.start_s), scene.start_s[:, None]
    slow, fast, along = slow_gaussian_process(at_s)[:, 0], slow_gaussian_process(at_s, SHORT_CORRELATION_FRACTION)[:, 0], at_s / at_s.max()
    pair = (scene.pair[:, None] == np.unique(scene.pair)).astype(np.float64)
    courses = [slow, fast, pair, np.eye(f), along, along**2, np.where(np.arange(f) % 2 == 0, 1.0, -1.0)[:, None]]
    if scene.load.any():
        loaded = scene.steps.loaded[:, None].astype(np.float64)
        courses += [scene.load, fast * loaded, fast * (1.0 - loaded)]
    return tuple(courses)


def _course_evidence(normal: Array, gradient: Array, course: Array) -> tuple[float, float]:
    """Log Bayes factor of a time course (f, q), mean over sizes, and log likelihood gain of the fit at the most likely size."""
    course = course / (np.sqrt(np.mean(np.sum(course**2, axis=1))) or 1.0)
    values, vectors = np.linalg.eigh(course.T @ normal @ course)
    values, along = np.clip(values, 0.0, None), vectors.T @ (course.T @ gradient)
    each = log_factor(values[None], along[None], SIZES_PX[:, None])
    most_likely = SIZES_PX[int(np.argmax(each))] ** -2.0
    return float(np.logaddexp.reduce(each) - np.log(len(SIZES_PX))), float(0.5 * np.sum(along**2 / (values + most_likely)))
