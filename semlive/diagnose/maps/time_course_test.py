"""Test of the time course of identified effects: the same spatial shape with another course over the frames.

An effect with an amplitude for every pair fits any field of its shape without residual. With `magnification_drift` removed from the
dictionary, a slow drift was identified as `refocus_magnification_step`, a magnification jump at every step.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import BaselineEffect, DesignMatrix, HyperparameterGrid, point_like
from semlive.diagnose.baseline.bayes_factor import log_factor, project
from semlive.diagnose.maps.refinement import RefinedEffect
from semlive.model.effects import RunGeometry
from semlive.model.effects.run_geometry import slow_gaussian_process

Array = NDArray[np.float64]

SIZES_PX = np.geomspace(3e-4, 3.0, 12)
MOVED_PX = 1.0  # that a frame may be moved as a whole: jumps and drift do that, and it is no shape
MIN_SHAPE_SHARE = 0.9  # of what an effect moves, or it has no shape that could go otherwise
FORGIVEN_GAIN_FRACTION = (
    0.03  # of what a shape gains, nature's course may gain more than a law's: a charged spot as large as eight times the least, 6 of 190
)
SHORT_CORRELATION_FRACTION = 0.15  # of the run, over which a faster wandering is alike


def alternative_time_course_odds(
    baseline_with_effects: HyperparameterGrid, baseline: DesignMatrix, effects: Sequence[RefinedEffect]
) -> float:
    """Logarithm of the odds for another course of an effect's shape, against nearly the course of its law; the largest of all effects.

    Args:
        baseline_with_effects: the baseline with the effects. Its smoothness must be selected with the effects in the model: a smoothness
            selected without them absorbs a part of the effects and changes the residual time course. For a wrong row time this
            gave a log odds of 17 instead of -0.1.
        baseline: the same without them.
        effects: the effects; each is asked about with the others in the baseline.
    """
    return max(
        (_of_one(baseline_with_effects, baseline, effect, [other for other in effects if other is not effect]) for effect in effects),
        default=-np.inf,
    )


def _of_one(
    baseline_with_effects: HyperparameterGrid, columns: DesignMatrix, effect: RefinedEffect, other_effects: Sequence[RefinedEffect]
) -> float:
    shape, share = _shape(effect)
    if share < MIN_SHAPE_SHARE:
        return -np.inf
    lawful = _own_course(effect, shape)
    for found in (*(other.baseline_effect for other in other_effects), _rest(columns, effect, shape, lawful)):
        columns = columns.with_effects(found)
    base = point_like(columns, baseline_with_effects)
    normal, pull = _of_frames(base, shape)
    own = _heard(normal, pull, lawful)
    return max(_gain(_heard(normal, pull, course), own) for course in _courses(base.design.observation.geometry))


def _gain(other: tuple[float, float], own: tuple[float, float]) -> float:
    """Logarithm of the odds, a little of what the other course fits better being forgiven."""
    forgiven = np.clip(other[1] - own[1], 0.0, FORGIVEN_GAIN_FRACTION * max(own[1], 0.0))
    return float(other[0] - own[0] - forgiven)


def _of_frames(base: HyperparameterGrid, shape: Array) -> tuple[Array, Array]:
    """(f, f) information on a shape's size in each frame, and (f,) what the data ask for; frames may be moved besides."""
    f = base.design.observation.frames
    field = np.zeros((f, *shape.shape, 3, f))
    for place, value in enumerate((shape, (1.0, 0.0), (0.0, 1.0))):
        field[np.arange(f), :, :, place, np.arange(f)] = value
    gradient = project(base, field.reshape(*field.shape[:3], 3 * f))
    normal = (gradient.vectors[0] * gradient.values[0]) @ gradient.vectors[0].T
    pull = gradient.vectors[0] @ gradient.gradient[0]
    projected = np.linalg.solve(normal[f:, f:] + np.eye(2 * f) / MOVED_PX**2, np.column_stack((normal[f:, :f], pull[f:])))
    return normal[:f, :f] - normal[:f, f:] @ projected[:, :f], pull[:f] - normal[:f, f:] @ projected[:, f]


def _shape(effect: RefinedEffect) -> tuple[Array, float]:
    """(b, 2) the shape that explains most of what an effect moves but translations, which are drift's, and how much of it."""
    moved = effect.field_px @ effect.amplitudes
    bent = moved - moved[0]
    bent = bent - bent.mean(axis=1, keepdims=True)
    _, size, shapes = np.linalg.svd(bent.reshape(len(bent), -1), full_matrices=False)
    shape = shapes[0].reshape(bent.shape[1:])
    return shape / np.sqrt(np.mean(np.sum(shape**2, axis=-1))), float(size[0] ** 2 / np.sum(size**2)) if size[0] > 0.0 else 0.0


def _own_course(effect: RefinedEffect, shape: Array) -> Array:
    """(f, q) how the law's columns have the shape in each frame."""
    bent = effect.field_px - effect.field_px.mean(axis=1, keepdims=True)
    return np.einsum("fbcq,bc->fq", bent, shape) / np.sum(shape**2)


def _rest(columns: DesignMatrix, effect: RefinedEffect, shape: Array, course: Array) -> BaselineEffect:
    """What a law moves besides: of any course.

    A swing that takes twice a frame's time has two shapes, of which one has 96 %. What the other leaves was found in its course, with odds
    of exp(72) at eight times the least; with the rest beside, exp(-13).
    """
    return BaselineEffect(
        columns.whiten(effect.field_px - shape[None, :, :, None] * course[:, None, None, :]), effect.baseline_effect.size_px
    )


def _courses(scene: RunGeometry) -> tuple[Array, ...]:
    """Columns (f, q) whose random sums are a course: slow, faster, of each pair, of each frame, a power of time, in turn, with the load."""
    f, at_s = len(scene.start_s), scene.start_s[:, None]
    slow, fast, along = slow_gaussian_process(at_s)[:, 0], slow_gaussian_process(at_s, SHORT_CORRELATION_FRACTION)[:, 0], at_s / at_s.max()
    pair = (scene.pair[:, None] == np.unique(scene.pair)).astype(np.float64)
    found = [slow, fast, pair, np.eye(f), along, along**2, np.where(np.arange(f) % 2 == 0, 1.0, -1.0)[:, None]]
    if scene.load.any():
        loaded = scene.loaded[:, None].astype(np.float64)
        found += [scene.load, fast * loaded, fast * (1.0 - loaded)]
    return tuple(found)


def _heard(normal: Array, pull: Array, course: Array) -> tuple[float, float]:
    """Logarithm of the Bayes factor of a course (f, q) against none, the mean over sizes, and of the fit alone at the likeliest size."""
    course = course / (np.sqrt(np.mean(np.sum(course**2, axis=1))) or 1.0)
    values, vectors = np.linalg.eigh(course.T @ normal @ course)
    values, along = np.clip(values, 0.0, None), vectors.T @ (course.T @ pull)
    each = log_factor(values[None], along[None], SIZES_PX[:, None])
    likeliest = SIZES_PX[int(np.argmax(each))] ** -2.0
    return float(np.logaddexp.reduce(each) - np.log(len(SIZES_PX))), float(0.5 * np.sum(along**2 / (values + likeliest)))
