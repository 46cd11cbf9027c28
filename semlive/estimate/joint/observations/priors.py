"""Priors of the joint estimate: smoothness, and gauge conditions that fix directions the data do not determine."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.estimate.joint.observations.state import EstimatorState
from semlive.model import DistortionSpline, DriftSpline, Gap, MotionKind, RasterChange, differences_across

Kind = tuple[int, float]
"""Order and swing of a `Smoothness`."""

GAUGE_PX = 1e-4  # fixes directions that the data do not determine, so its size does not change the result
SHIFT_PX = 1e3
GRADIENT = 0.1
AXES = 0.02
RASTER_PX = 5.0  # 1 % of magnification
STILL_PX = 1e-7


BASE_PX = 30.0
"""Size of second differences of knots in a prior that is always added, so that no wave is free with a high order of the selected prior.

With 3 px, a distortion with waves of 2.5 knots and second differences of 14 px gave residuals 5 % above the noise.
"""
UNINFORMATIVE_PX = 300.0


OSCILLATION_DAMPING = 0.7
"""Logarithmic decrement of one oscillation; cooling and pumps do not keep their phase."""
MAX_COUPLED_KNOTS = 4
"""Largest number of knots to which a prior couples a knot."""


@dataclass(frozen=True, slots=True)
class DifferencePenalty:
    """Gaussian prior with zero mean on the filtered differences of a series of coefficients.

    Attributes:
        order: order of the differences.
        precision: precision of each filtered difference, 1/px^2.
        taps: filter over neighbouring differences, newest first.
    """

    order: int
    precision: float
    taps: tuple[float, ...] = (1.0,)

    @property
    def reach(self) -> int:
        """Number of earlier coefficients coupled to each coefficient."""
        return self.order + len(self.taps) - 1

    @property
    def weights(self) -> NDArray[np.float64]:
        """(reach + 1,) weights of the coupled coefficients, oldest first."""
        signs = [(-1.0) ** (self.order - k) * math.comb(self.order, k) for k in range(self.order + 1)]
        return np.convolve(signs, self.taps[::-1])

    def across(self, count: int, gaps: Sequence[Gap]) -> Iterator[tuple[slice, slice, NDArray[np.float64]]]:
        """The filtered differences of a series of `count` coefficients that are others because of its gaps."""
        return differences_across(self.order, self.taps, count, gaps)

    def of(self, value: NDArray[np.float64], gaps: Sequence[Gap] = ()) -> NDArray[np.float64]:
        """(n - reach,) filtered differences of a series (n,), computed from plain differences to avoid cancellation of large values."""
        bent = np.convolve(np.diff(value, n=self.order), self.taps, mode="valid") if len(value) > self.reach else np.zeros(0)
        for rows, columns, weights in self.across(len(value), gaps):
            bent[rows] = weights @ value[columns]
        return bent

    def reversed(self, bent: NDArray[np.float64], gaps: Sequence[Gap] = ()) -> NDArray[np.float64]:
        """(n,) the transpose of `of`, for filtered differences (n - reach,)."""
        across, plain = list(self.across(len(bent) + self.reach, gaps)), bent.copy()
        for rows, _, _ in across:
            plain[rows] = 0.0
        total = np.convolve(plain, self.taps[::-1], mode="full")
        for _ in range(self.order):
            total = np.diff(total, prepend=0.0, append=0.0)
        total *= (-1.0) ** self.order
        for rows, columns, weights in across:
            total[columns] += weights.T @ bent[rows]
        return total

    def rows(self, count: int, gaps: Sequence[Gap] = ()) -> NDArray[np.float64]:
        """(count - reach, count) matrix of the filtered differences."""
        weights, rows = self.weights, np.zeros((max(count - self.reach, 0), count))
        for row in range(len(rows)):
            rows[row, row : row + len(weights)] = weights
        for at, columns, across in self.across(count, gaps):
            rows[at] = 0.0
            rows[at, columns] = across
        return rows


@dataclass(frozen=True, slots=True)
class Smoothness:
    """Prior smoothness of one component of a spline: ``size_px`` is the typical difference of the given order between knots.

    Attributes:
        order: order of the difference. 2 permits curvature anywhere; with higher orders long waves are free and short ones more restricted.
        size_px: typical difference of that order for slow changes, px.
        oscillation_period_knots: period of a preferred oscillation, as caused by cycling of the laboratory cooling, in knots; 0 for none.
    """

    order: int
    size_px: float
    oscillation_period_knots: float = 0.0

    @property
    def kind(self) -> Kind:
        """Order and oscillation period, without the size."""
        return self.order, self.oscillation_period_knots

    @property
    def filter(self) -> DifferencePenalty:
        """The penalty on filtered differences."""
        tight = self.size_px**-2.0
        if not self.oscillation_period_knots:
            return DifferencePenalty(self.order, tight)
        damping = math.exp(-OSCILLATION_DAMPING / self.oscillation_period_knots)
        taps = np.array([1.0, -2.0 * damping * math.cos(2.0 * math.pi / self.oscillation_period_knots), damping**2])
        return DifferencePenalty(self.order, tight, tuple(float(value) for value in taps / taps.sum()))

    def roughness(self, effect: DriftSpline | DistortionSpline) -> NDArray[np.float64]:
        """(m, m) precision of one component of an effect."""
        penalty = self.filter
        if len(penalty.taps) == 1:
            return effect.roughness(penalty.order) * penalty.precision
        rows = penalty.rows(effect.size // 2, gaps_of(effect))
        return penalty.precision * (rows.T @ rows)


def gaps_of(effect: DriftSpline | DistortionSpline) -> list[Gap]:
    """The gaps in the knots of an effect; a distortion has none."""
    return effect.spline.gaps_within(0, effect.spline.size) if isinstance(effect, DriftSpline) else []


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """Noise scale and prior sizes, selected from the data by marginal likelihood.

    Attributes:
        noise_scale: factor on the standard deviations of the DIC that explains the residuals.
        drift: smoothness of the drift along x and y.
        distortion: smoothness of the distortion along x and y.
        rotation_rad: typical rotation of the specimen caused by a translation, rad.
        raster_px: typical second difference between knots of magnification and rotation of the raster, at half the image width, px; 0
            for a constant raster.
        row_shift_px: typical shift of a group of rows, px; 0 for no row shifts.
    """

    noise_scale: float = 1.0
    drift: tuple[Smoothness, Smoothness] = (Smoothness(2, 0.05), Smoothness(2, 0.05))
    distortion: tuple[Smoothness, Smoothness] = (Smoothness(2, 0.5), Smoothness(2, 0.5))
    rotation_rad: float = 1e-2
    raster_px: tuple[float, float] = (0.0, 0.0)
    row_shift_px: float = 0.0


def gauge_precision(state: EstimatorState) -> NDArray[np.float64]:
    """(n, n) precision of gauge conditions F1 to F3, of start times, and of the wide priors of shifts and gradients.

    F1 and F2: mean and best affine map of the distortion over the grid are zero. Unknown translations determine neither, and neither can
    create apparent strain. F3: drift, magnification and rotation are zero at the start of frame 0. F4, a drift step between
    pairs against the
    shift of the specimen, is fixed by the smoothness of the drift. The drift is interpolated there and sigma includes the uncertainty.
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
    starts = np.arange(*layout.part("start_time").indices(layout.size))
    total[starts, starts] = np.array(state.start_time_errors.sigma_s) ** -2.0
    motion = layout.part("motion")
    diagonal = np.arange(motion.start, motion.stop)
    total[diagonal, diagonal] = motion_prior(state, None)
    return total


def motion_prior(state: EstimatorState, rotation_rad: float | None) -> NDArray[np.float64]:
    """(k,) precision of the wide priors of shifts and gradients, and of rotations unless `rotation_rad` is None."""
    turn, shift, gradient = 0.0 if rotation_rad is None else rotation_rad**-2.0, SHIFT_PX**-2, GRADIENT**-2
    rigid, free = (shift, shift, turn), (shift, gradient, gradient) * 2
    return np.array([value for kind in state.motions.kinds for value in (rigid if kind is MotionKind.RIGID else free)])


def raster_prior(change: RasterChange, size_px: float) -> NDArray[np.float64]:
    """(size, size) precision of a raster effect: smooth in time, or fixed at zero if `size_px` is 0."""
    identity = np.eye(change.size)
    return identity * STILL_PX**-2.0 if size_px == 0.0 else identity * RASTER_PX**-2.0 + change.roughness() * size_px**-2.0


def rotation_indices(state: EstimatorState) -> NDArray[np.int64]:
    """(k,) joint indices of the rotation angles of pairs with rigid motion."""
    start = state.layout.part("motion").start
    found = [
        state.motions.part(pair)[0].start + 2
        for pair, kind in zip(state.motions.pairs, state.motions.kinds, strict=True)
        if kind is MotionKind.RIGID
    ]
    return start + np.array(found, dtype=np.int64)


def prior_precision(state: EstimatorState, hyper: Hyperparameters) -> NDArray[np.float64]:
    """(n, n) prior precision of drift (second derivative is white noise), distortion (bending energy), raster, rotations and row shifts."""
    layout = state.layout
    total = np.zeros((layout.size, layout.size))
    for effect, kinds in ((state.distortion, hyper.distortion), (state.drift, hyper.drift)):
        if effect is not None:
            part = layout.part(effect.name)
            total[part, part] = smoothness_precision(effect, kinds)
    for change, size_px in zip(state.raster, hyper.raster_px, strict=False):
        part = layout.part(change.name)
        total[part, part] += raster_prior(change, size_px)
    at = rotation_indices(state)
    total[at, at] = hyper.rotation_rad**-2.0
    lines = np.arange(*layout.part("line_shift").indices(layout.size))
    total[lines, lines] = hyper.row_shift_px**-2.0 if lines.size else 0.0
    return total


def smoothness_precision(effect: DriftSpline | DistortionSpline, kinds: Sequence[Smoothness]) -> NDArray[np.float64]:
    """(m, m) prior precision of drift or distortion, for the smoothness of each component."""
    total = np.zeros((effect.size, effect.size))
    base = effect.roughness() * BASE_PX**-2.0
    for axis, kind in enumerate(kinds):
        total[axis::2, axis::2] = base + kind.roughness(effect)
    return total


def _add(total: NDArray[np.float64], part: slice, addend: NDArray[np.float64]) -> None:
    for axis in (0, 1):
        at = slice(part.start + axis, part.stop, 2)
        total[at, at] += addend
