"""Run geometry: positions and times at which every frame observed every block of points, for the prediction of effects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FrameSteps:
    """The step of the plan before each frame.

    Attributes:
        loaded: (f,) whether the pair belongs to the tension phase.
        gradient_free: (f,) whether the displacement gradient of the specimen is free in the pair; calibration pairs have rigid motion.
        load_n: (f,) mean load, 0 without a load frame.
        load_change_n: (f,) change of the load by the step before the pair, N.
        move_px: (f, 2) commanded translation by the step before the pair, px.
        since_step_s: (f,) time from the end of that step to the start of the scan, s.
    """

    loaded: NDArray[np.bool_]
    gradient_free: NDArray[np.bool_]
    load_n: Array
    load_change_n: Array
    move_px: Array
    since_step_s: Array


@dataclass(frozen=True, slots=True, eq=False)
class RunGeometry:
    """Arrays over frames (f) and blocks (b), frame 0 first.

    Attributes:
        address_px: (f, b, 2) scan address relative to the image centre.
        disparity_px: (f, b, 2) disparity since frame 0 by the first estimate, without noise.
        composed: (f,) whether the map to the frame was composed of those to the first frame of its pair and within the pair.
        time_s: (f, b) scan time, seconds after the start of frame 0.
        time_in_frame_s: (f, b) scan time after the start of the frame, s.
        time_in_row_s: (f, b) scan time after the start of the row, in one pass, s.
        drift_rate_px_s: (f, b, 2) drift rate by the first estimate between the frames of a pair, interpolated over time.
        distortion_px: (f, b, 2) distortion by the first estimate.
        half_px: half of the image width.
        half_height_px: half of the image height.
        frame: (f,) numbers of the frames.
        pair: (f,) numbers of their pairs.
        start_s: (f,) start of the scan, seconds after that of frame 0.
        steps: the step of the plan before each frame.
        drift_knot_s: knot distance of the drift spline, s.
        distortion_knot_px: largest knot distance of the distortion spline, px.
        pixel_ratio: pixel size relative to that of the run with which it is compared.
        subset_s: scan time of the rows of a subset, s; 0 for points that are no means.
    """

    address_px: Array
    disparity_px: Array
    composed: NDArray[np.bool_]
    time_s: Array
    time_in_frame_s: Array
    time_in_row_s: Array
    drift_rate_px_s: Array
    distortion_px: Array
    half_px: float
    half_height_px: float
    frame: NDArray[np.int64]
    pair: NDArray[np.int64]
    start_s: Array
    steps: FrameSteps
    drift_knot_s: float
    distortion_knot_px: float
    pixel_ratio: float = 1.0
    subset_s: float = 0.0

    @property
    def x(self) -> Array:
        """(f, b) column from the centre, in half widths."""
        return self.address_px[..., 0] / self.half_px

    @property
    def y(self) -> Array:
        """(f, b) row from the centre, in half widths."""
        return self.address_px[..., 1] / self.half_px

    @property
    def pixel_px(self) -> Array:
        """(f, b, 2) column and row from the first pixel of the frame, px."""
        return self.address_px + np.array([self.half_px, self.half_height_px])

    @property
    def measured_parts_px(self) -> Array:
        """(2, f, b, 2) the disparity as a sum of those that the correlation measured, px: two in a composed map, else one and zero."""
        first = np.where(self.composed, np.arange(len(self.frame)) - 1, 0)  # frame 0 has no disparity
        return np.stack((self.disparity_px - self.disparity_px[first], self.disparity_px[first]))

    @property
    def load(self) -> Array:
        """(f, 1) load relative to the highest load of the run; zero without a load frame."""
        highest = float(np.abs(self.steps.load_n).max())
        return np.where(self.steps.loaded, self.steps.load_n / (highest or 1.0), 0.0)[:, None]

    @property
    def highest_n(self) -> float:
        """The highest load of the run, N."""
        return float(np.abs(self.steps.load_n).max())

    @property
    def end_s(self) -> float:
        """Scan time of the last block, seconds after the start of frame 0."""
        return float(self.time_s.max())

    @property
    def row_start_s(self) -> Array:
        """(f, b) start of the row, seconds after the start of the frame."""
        return self.time_in_frame_s - self.time_in_row_s

    @property
    def since_step_at_s(self) -> Array:
        """(f, b) time since the end of the step before the pair, s."""
        return self.steps.since_step_s[:, None] + self.time_in_frame_s


def field_column(u: Array, v: Array) -> Array:
    """(f, b, 2, 1) one column with components u and v, which broadcast."""
    return np.stack(np.broadcast_arrays(u, v), axis=-1)[..., None]


def xy_columns(shape: Array) -> Array:
    """(f, b, 2, 2) a shape along x, and along y."""
    columns = np.zeros((*shape.shape, 2, 2))
    columns[..., 0, 0] = columns[..., 1, 1] = shape
    return columns


def times_time_columns(shape: Array, columns: Array) -> Array:
    """(f, b, 2, q) a shape (f, b, 2, 1) times columns in time (f, b or 1, q)."""
    return shape * columns[:, :, None, :]


def exponential_decay(scene: RunGeometry, steps: Array, time_constant_s: float) -> Array:
    """(f, b, c) sum of the exponential decays exp(-(T - T_k) / tau) of all steps (f, c) so far."""
    first = np.flatnonzero(np.diff(scene.pair, prepend=scene.pair[0] - 1))
    since_s = scene.time_s - (scene.start_s - scene.steps.since_step_s)[first, None, None]
    decay = np.where(since_s >= 0.0, np.exp(-np.maximum(since_s, 0.0) / time_constant_s), 0.0)
    return np.einsum("kfb,kc->fbc", decay, steps[first])


def slow_gaussian_process(time_s: Array, share: float = 0.5) -> Array:
    """(f, b, q) columns of a slow Gaussian process of unit variance that is 0 at the start of frame 0.

    Args:
        time_s: (f, b) scan times, s.
        share: correlation time, as a fraction of the run.
    """
    end_s = float(time_s.max())
    knots = np.linspace(0.0, end_s, _KNOTS)
    from_start = np.eye(_KNOTS)
    from_start[:, 0] -= 1.0
    covariance = from_start @ np.exp(-0.5 * (np.subtract.outer(knots, knots) / (share * end_s)) ** 2) @ from_start.T
    value, vector = np.linalg.eigh(covariance)
    distinct = value > _LEAST * value[-1]
    columns = (vector * np.sqrt(np.clip(value, 0.0, None)))[:, distinct][:, ::-1]
    return np.stack([np.interp(time_s, knots, value) for value in columns.T], axis=-1)


_KNOTS = 60
_LEAST = 1e-4
