"""What is believed before any data: smoothness, and the gauges that no data can fix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.estimate.state import EstimatorState
from semlive.model import MotionKind, RasterChange

GAUGE_PX = 1e-4  # pins directions that data cannot see, so its size changes no answer
SHIFT_PX = 1e3
GRADIENT = 0.1
AXES = 0.02
RASTER_PX = 5.0  # 1 % of magnification
STILL_PX = 1e-7


# Below any smoothness that the data choose there is this one, so that a high order leaves nothing free: second differences of knots.
# With 3 px a distortion whose waves are 2.5 knots long, with second differences of 14 px, left a twentieth more than the noise.
BASE_PX = 30.0
ANYWHERE_PX = 300.0


@dataclass(frozen=True, slots=True)
class Smoothness:
    """How one component of a spline is expected to vary: ``size`` is the typical difference of an order from knot to knot.

    Attributes:
        order: 2 where it may bend anywhere; higher orders leave long waves free and hold short ones more tightly.
        size_px: typical difference of that order.
    """

    order: int
    size_px: float


@dataclass(frozen=True, slots=True)
class Hyper:
    """The numbers that the data themselves choose.

    Attributes:
        noise_scale: what the DIC's own sigmas must be multiplied with to explain the residuals.
        drift: smoothness of the drift along x and y.
        distortion: smoothness of the distortion along x and y.
        rotation_rad: typical rotation of the specimen by a translation.
        raster_px: typical second difference, from knot to knot, of magnification and rotation of the raster, at half the
            image's width; 0 where the raster keeps still.
    """

    noise_scale: float = 1.0
    drift: tuple[Smoothness, Smoothness] = (Smoothness(2, 0.05), Smoothness(2, 0.05))
    distortion: tuple[Smoothness, Smoothness] = (Smoothness(2, 0.5), Smoothness(2, 0.5))
    rotation_rad: float = 1e-2
    raster_px: tuple[float, float] = (0.0, 0.0)


def gauge_precision(state: EstimatorState) -> NDArray[np.float64]:
    """(n, n) gauges F1 to F3 and the wide priors of shifts and gradients.

    F1, F2: mean and best affine map of the distortion over the grid are zero (unknown translations determine neither;
    they cannot make strain out of none). F3: drift, magnification and rotation are zero at the start of frame 0. F4, a step
    of the drift between pairs against the shift of the specimen, is left to the smoothness of the drift: interpolated, and
    sigma says so.
    """
    layout = state.layout
    total = np.zeros((layout.size, layout.size))
    affine = state.distortion.affine_rows(state.grid) / GAUGE_PX
    _add(total, layout.part("distortion"), affine.T @ affine)
    if state.drift is not None:
        start = state.drift.rows([0.0]) / GAUGE_PX
        _add(total, layout.part("drift"), start.T @ start)
    for change in state.raster:
        part = layout.part(change.name)
        start = change.rows([0.0]) * change.radius_px / GAUGE_PX
        total[part, part] += start.T @ start
    axes = np.arange(*layout.part("axes").indices(layout.size))
    total[axes, axes] = AXES**-2.0
    motion = layout.part("motion")
    diagonal = np.arange(motion.start, motion.stop)
    total[diagonal, diagonal] = gauge_of_motions(state, None)
    return total


def gauge_of_motions(state: EstimatorState, rotation_rad: float | None) -> NDArray[np.float64]:
    """(k,) precision of the wide priors of shifts and gradients, and of rotations where their size is given."""
    turn, shift, gradient = 0.0 if rotation_rad is None else rotation_rad**-2.0, SHIFT_PX**-2, GRADIENT**-2
    rigid, free = (shift, shift, turn), (shift, gradient, gradient) * 2
    return np.array([value for kind in state.motions.kinds for value in (rigid if kind is MotionKind.RIGID else free)])


def raster_belief(change: RasterChange, size_px: float) -> NDArray[np.float64]:
    """(size, size) precision of what the raster does: smooth in time, or nothing where `size_px` is 0."""
    one = np.eye(change.size)
    return one * STILL_PX**-2.0 if size_px == 0.0 else one * RASTER_PX**-2.0 + change.roughness() * size_px**-2.0


def angles(state: EstimatorState) -> NDArray[np.int64]:
    """(k,) joint indices of the rotation angles of the pairs that move rigidly."""
    start = state.layout.part("motion").start
    found = [
        state.motions.part(pair)[0].start + 2
        for pair, kind in zip(state.motions.pairs, state.motions.kinds, strict=True)
        if kind is MotionKind.RIGID
    ]
    return start + np.array(found, dtype=np.int64)


def belief_precision(state: EstimatorState, hyper: Hyper) -> NDArray[np.float64]:
    """(n, n) smoothness of drift (its second derivative is white noise) and of distortion (bending energy), size of rotations."""
    layout = state.layout
    total = np.zeros((layout.size, layout.size))
    for effect, kinds in ((state.distortion, hyper.distortion), (state.drift, hyper.drift)):
        if effect is None:
            continue
        part = layout.part(effect.name)
        base = effect.roughness() * BASE_PX**-2.0
        for axis, kind in enumerate(kinds):
            one = slice(part.start + axis, part.stop, 2)
            total[one, one] += base + effect.roughness(kind.order) * kind.size_px**-2.0
    for change, size_px in zip(state.raster, hyper.raster_px, strict=False):
        part = layout.part(change.name)
        total[part, part] += raster_belief(change, size_px)
    at = angles(state)
    total[at, at] = hyper.rotation_rad**-2.0
    return total


def _add(total: NDArray[np.float64], part: slice, one: NDArray[np.float64]) -> None:
    for axis in (0, 1):
        at = slice(part.start + axis, part.stop, 2)
        total[at, at] += one
