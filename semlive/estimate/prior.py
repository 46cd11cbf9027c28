"""What is believed before any data: smoothness, and the gauges that no data can fix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.estimate.state import EstimatorState
from semlive.model import MotionKind

GAUGE_PX = 1e-4  # pins directions that data cannot see, so its size changes no answer
SHIFT_PX = 1e3
GRADIENT = 0.1


@dataclass(frozen=True, slots=True)
class Hyper:
    """The numbers that the data themselves choose.

    Attributes:
        noise_scale: what the DIC's own sigmas must be multiplied with to explain the residuals.
        drift_px: typical second difference of the drift from knot to knot, along x and y.
        distortion_px: typical second difference of the distortion from knot to knot, along x and y.
        rotation_rad: typical rotation of the specimen by a translation.
    """

    noise_scale: float = 1.0
    drift_px: tuple[float, float] = (0.05, 0.05)
    distortion_px: tuple[float, float] = (0.5, 0.5)
    rotation_rad: float = 1e-2


def gauge_precision(state: EstimatorState) -> NDArray[np.float64]:
    """(n, n) gauges F1 to F3 and the wide priors of shifts and gradients.

    F1, F2: mean and best affine map of the distortion over the grid are zero (unknown translations determine neither;
    they cannot make strain out of none). F3: the drift is zero at the start of frame 0. F4, a step of the drift between
    pairs against the shift of the specimen, is left to the smoothness of the drift: interpolated, and sigma says so.
    """
    layout = state.layout
    total = np.zeros((layout.size, layout.size))
    affine = state.distortion.affine_rows(state.grid) / GAUGE_PX
    _add(total, layout.part("distortion"), affine.T @ affine)
    if state.drift is not None:
        start = state.drift.rows([0.0]) / GAUGE_PX
        _add(total, layout.part("drift"), start.T @ start)
    motion = layout.part("motion")
    precision = [
        value
        for kind in state.motions.kinds
        for value in ((SHIFT_PX**-2, SHIFT_PX**-2, 0.0) if kind is MotionKind.RIGID else (SHIFT_PX**-2, GRADIENT**-2, GRADIENT**-2) * 2)
    ]
    diagonal = np.arange(motion.start, motion.stop)
    total[diagonal, diagonal] = precision
    return total


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
    for name, roughness, scale in _rough(state, hyper):
        part = layout.part(name)
        for axis in (0, 1):
            one = slice(part.start + axis, part.stop, 2)
            total[one, one] += roughness / scale[axis] ** 2
    at = angles(state)
    total[at, at] = hyper.rotation_rad**-2.0
    return total


def _rough(state: EstimatorState, hyper: Hyper) -> list[tuple[str, NDArray[np.float64], tuple[float, float]]]:
    found = [("distortion", state.distortion.roughness(), hyper.distortion_px)]
    if state.drift is not None:
        found.append(("drift", state.drift.roughness(), hyper.drift_px))
    return found


def _add(total: NDArray[np.float64], part: slice, one: NDArray[np.float64]) -> None:
    for axis in (0, 1):
        at = slice(part.start + axis, part.stop, 2)
        total[at, at] += one
