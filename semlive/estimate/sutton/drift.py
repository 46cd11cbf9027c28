"""Local drift: velocity from pairs, a B-spline in time at every position, integrated (Sutton 2007, equations 4 and 8)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.ndimage import gaussian_filter, map_coordinates

from semlive.data.drift import FrameTime
from semlive.data.grid import Grid
from semlive.errors import IllPosed
from semlive.estimate.sutton.state import PairMaps

Array = NDArray[np.float64]
Removal = Callable[[Array, Array, FrameTime, FrameTime], Array]
"""(n, 2) what the distortion adds to the disparities between addresses (n, 2), (n, 2) of two frames."""

FILL_PX = 30.0  # positions that too few pairs saw take the mean of their neighbours


@dataclass(frozen=True, slots=True, eq=False)
class LocalDrift:
    """D(X, T): drift at every sensor position X as a function of time T, zero at pixel (0, 0) of the first frame.

    Attributes:
        first: the first frame of the phase.
        grid: positions.
        spline: velocity in px/s over time since frame 0; its coefficients are (K, ny, nx, 2).
        integral: of `spline`.
        row_time_s: (rows,) time at which each image row of the first frame was scanned, s.
        path_px: (rows, 2) drift at those times, integrated along the path of the beam (footnote 3).
        velocity_sd_px_s: standard deviation of one position's measured velocity about its spline.
        noise_fraction: fraction of the noise variance that remains after the spatial smoothing.
    """

    first: FrameTime
    grid: Grid
    spline: BSpline
    integral: BSpline
    row_time_s: Array
    path_px: Array
    velocity_sd_px_s: float
    noise_fraction: float

    def at(self, address_px: Array, when: FrameTime) -> Array:
        """(n, 2) drift at scan addresses (n, 2) of a frame."""
        begin_s = self.first.start_s + self.first.timing.time_in_frame_s(address_px[:, 0], address_px[:, 1])
        now_s = when.start_s + when.timing.time_in_frame_s(address_px[:, 0], address_px[:, 1])
        start_px = np.stack([np.interp(begin_s, self.row_time_s, value) for value in self.path_px.T], axis=1)
        if when.frame == self.first.frame:
            return start_px
        return start_px + self._integrated(address_px, now_s) - self._integrated(address_px, begin_s)

    def rate_at(self, address_px: Array, when: FrameTime) -> Array:
        """(n, 2) drift velocity at scan addresses (n, 2) of a frame, px/s."""
        now_s = when.start_s + when.timing.time_in_frame_s(address_px[:, 0], address_px[:, 1])
        return np.einsum("nk,nkc->nc", _basis(self.spline)(now_s), self._local(self.spline.c, address_px))

    def sigma_px(self, when: FrameTime, pair_times_s: Array) -> float:
        """Standard uncertainty of the drift accumulated between the first frame and another, at one position."""
        basis = _basis(self.spline)
        design, reach = basis(pair_times_s), np.asarray(basis.antiderivative()(when.start_s) - basis.antiderivative()(self.first.start_s))
        covariance = np.linalg.pinv(design.T @ design)
        return float(self.velocity_sd_px_s * np.sqrt(self.noise_fraction * reach @ covariance @ reach))

    def _integrated(self, address_px: Array, time_s: Array) -> Array:
        return np.einsum("nk,nkc->nc", _basis(self.spline).antiderivative()(time_s), self._local(self.spline.c, address_px))

    def _local(self, coefficients: Array, address_px: Array) -> Array:
        """(n, K, 2) coefficients at addresses; beyond the grid those of its edge."""
        grid = self.grid
        where = np.stack(((address_px[:, 1] - grid.y0_px) / grid.step_px, (address_px[:, 0] - grid.x0_px) / grid.step_px))
        local = [
            [map_coordinates(coefficient[..., axis], where, order=1, mode="nearest") for axis in (0, 1)] for coefficient in coefficients
        ]
        return np.ascontiguousarray(np.transpose(np.array(local), (2, 0, 1)))


def estimated(
    pairs: Sequence[PairMaps], grid: Grid, height_px: int, coefficients: int, smoothing_px: float, removal: Removal | None
) -> LocalDrift:  # fmt: skip
    """The local drift of a phase.

    Args:
        pairs: of the phase, in order of time.
        grid: positions.
        height_px: image height.
        coefficients: of the spline in time, at most; fewer where pairs are few (half their number).
        smoothing_px: standard deviation of the Gaussian that smooths the coefficients over positions; 0 for none.
        removal: distortion to take out of the disparities first, None in the first pass.

    Raises:
        IllPosed: no pair has a map within itself.
    """
    first, measured = pairs[0].times[0], [pair for pair in pairs if pair.within is not None]
    if not measured:
        raise IllPosed(
            f"no pair from pair {pairs[0].pair} on has a map within itself, so drift is unknown: correlate the pairs' own frames"
        )
    count = min(coefficients, (len(measured) + 1) // 2)
    end_s = max(pairs[-1].times[1].start_s + pairs[-1].times[1].timing.duration_s, first.start_s + 1.0)
    knots, degree = _knots(first.start_s, end_s, count)
    basis = BSpline(knots, np.eye(count), degree)
    time_s, velocity, observed = _velocities(measured, grid, removal)
    raw, enough = _fitted(basis(time_s), velocity, observed)
    residual = (velocity - np.einsum("pnk,nkc->pnc", basis(time_s), raw))[observed & enough]
    freedom = max(1.0 - count / len(measured), 0.25)
    sd = 1.4826 * float(np.median(np.abs(residual))) / np.sqrt(freedom) if residual.size else 0.0
    shaped = np.transpose(raw, (1, 0, 2)).reshape(count, *grid.shape, 2)
    smooth = np.stack([_smoothed(value, enough.reshape(grid.shape), smoothing_px / grid.step_px, grid.step_px) for value in shaped])
    spline = BSpline(knots, smooth, degree)
    row_time_s, path_px = _path(first, spline, grid, height_px)
    transfer = grid.subset_px**2 / (grid.subset_px**2 + 4.0 * np.pi * smoothing_px**2)
    return LocalDrift(first, grid, spline, spline.antiderivative(), row_time_s, path_px, sd, float(transfer))


def _velocities(pairs: Sequence[PairMaps], grid: Grid, removal: Removal | None) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Middle times (pairs, n), central differences (pairs, n, 2) in px/s, and where they were seen (pairs, n)."""
    here = np.stack(grid.mesh(), axis=-1).reshape(-1, 2)
    times, velocities, observed = [], [], []
    for pair in pairs:
        dmap, (first, second) = pair.within, pair.times
        assert dmap is not None  # only pairs with a map come here
        disparity = np.stack((dmap.u_px.ravel(), dmap.v_px.ravel()), axis=1)
        there = here + disparity
        before_s = first.start_s + first.timing.time_in_frame_s(here[:, 0], here[:, 1])
        after_s = second.start_s + second.timing.time_in_frame_s(there[:, 0], there[:, 1])  # t_disp of equation 8 is in it
        if removal is not None:
            disparity = disparity - removal(here, there, first, second)
        times.append(0.5 * (before_s + after_s))
        velocities.append(disparity / (after_s - before_s)[:, None])
        observed.append(dmap.valid.ravel())
    return np.array(times), np.array(velocities), np.array(observed)


def _fitted(design: Array, velocity: Array, observed: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """(n, K, 2) coefficients of every position by least squares, and (n,) where enough pairs were seen."""
    count = design.shape[2]
    enough = observed.sum(axis=0) >= count  # pairs differ in time, so as many as coefficients determine them
    weighted = design * observed[..., None]
    normal = np.einsum("pnk,pnl->nkl", weighted, design, optimize=True)
    right = np.einsum("pnk,pnc->nkc", weighted, velocity, optimize=True)
    normal[~enough] = np.eye(count)
    right[~enough] = 0.0
    if not enough.any():
        raise IllPosed("no position was correlated in enough pairs for a drift of its own: check focus and contrast")
    return np.linalg.solve(normal, right), enough


def _smoothed(coefficient: Array, valid: NDArray[np.bool_], sd_points: float, step_px: int) -> Array:
    """(ny, nx, 2) smoothed; positions without a value are filled from their neighbours even where nothing is smoothed."""
    if sd_points <= 0 and valid.all():
        return coefficient
    reach = sd_points if sd_points > 0 else FILL_PX / step_px
    weight = gaussian_filter(valid.astype(np.float64), reach, mode="constant")
    mean = [gaussian_filter(coefficient[..., axis] * valid, reach, mode="constant") / np.maximum(weight, 1e-12) for axis in (0, 1)]
    smooth = np.stack(mean, axis=-1)
    return smooth if sd_points > 0 else np.where(valid[..., None], coefficient, smooth)


def _path(first: FrameTime, spline: BSpline, grid: Grid, height_px: int) -> tuple[Array, Array]:
    """Times of the first frame's rows and the drift at them: velocities of the positions passed, summed along the way."""
    rows = np.arange(height_px + 1, dtype=np.float64)
    time_s = first.start_s + first.timing.time_in_frame_s(np.full(rows.shape, float(np.mean(grid.x_px))), rows)
    mean = np.asarray(spline.c).mean(axis=2)  # (K, ny, 2) over each row of positions
    basis = _basis(spline)(time_s)
    velocity = np.stack(
        [sum(basis[:, k] * np.interp(rows, grid.y_px, value[:, axis]) for k, value in enumerate(mean)) for axis in (0, 1)], axis=1
    )
    step = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time_s)[:, None]
    path = np.concatenate((np.zeros((1, 2)), np.cumsum(step, axis=0)))
    return time_s, path + velocity[0] * (time_s[0] - first.start_s)


def _knots(begin_s: float, end_s: float, count: int) -> tuple[Array, int]:
    """Clamped knots of a quadratic spline, or of a lower order where there are fewer coefficients."""
    degree = min(2, count - 1)
    inner = np.linspace(begin_s, end_s, count - degree + 1)
    return np.concatenate((np.full(degree, begin_s), inner, np.full(degree, end_s))), degree


def _basis(spline: BSpline) -> BSpline:
    return BSpline(spline.t, np.eye(len(spline.c)), spline.k)
