"""Settling at the row start: an exponential within the distortion, and what the prior of the distortion removes from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import DistortionField
from semlive.estimate import Solution
from semlive.model.distortion import DistortionSpline
from semlive.model.knots import KnotSpline
from semlive.model.splines import UniformSpline

Array = NDArray[np.float64]
COLUMNS = 40
"""Columns of the mean profile along rows in which a settling is searched."""
POLYNOMIALS = 4
"""Coefficients of the smooth part of a profile along one axis."""
LENGTHS = 16
SHORTEST_PX, LONGEST_SHARE = 10.0, 0.15
MIN_GAIN, MIN_GAIN_PER_MISFIT = 25.0, 2.0
"""Smallest gain in chi-squared of a settling at the row start over one at the row end, where no beam settles: absolute, and relative to
the misfit that remains. A smooth distortion has similar gains at both ends.
"""


@dataclass(frozen=True, slots=True)
class RowStart:
    """Settling at the row start within the distortion.

    Attributes:
        amplitude_px: (x, y) amplitude at the first calibrated column, px.
        length_px: length over which it decays by e.
    """

    amplitude_px: tuple[float, float]
    length_px: float

    def strain_per_px(self, gauge_px: float) -> float:
        """Largest false strain of a gauge at the row start per px of shift along x."""
        return float(np.hypot(*self.amplitude_px)) * (1.0 - np.exp(-gauge_px / self.length_px)) / gauge_px / self.length_px


@dataclass(frozen=True, slots=True, eq=False)
class _Template:
    """An exponential of one length at one end of the rows.

    Attributes:
        length_px: its length.
        columns: (2 COLUMNS, 2 POLYNOMIALS + 2) whitened profiles of polynomials along x and y, and of the exponential along x and y.
        removed: (2, m) what the prior removes from an exponential of 1 px along x and along y, as coefficients of the distortion.
    """

    length_px: float
    columns: Array
    removed: Array

    def fit(self, data: Array) -> tuple[Array, Array]:
        """(d,) sums of squared residuals of whitened profiles (2 COLUMNS, d), and amplitudes (2, d)."""
        solved = np.asarray(np.linalg.lstsq(self.columns, data, rcond=None)[0], dtype=np.float64)
        return np.sum((data - self.columns @ solved) ** 2, axis=0), solved[-2:]


@dataclass(frozen=True, slots=True, eq=False)
class RowStartFit:
    """Fit of an exponential to the mean over all rows of a distortion, beyond a cubic over the columns.

    The posterior mean has less of a steep settling than is there, because the prior of the distortion is equally smooth everywhere: the
    false strain of 1.2 px that decay within 15 px was 16 % too small, beyond its interval. The profile is therefore compared with an
    exponential from which the prior has removed the same part.

    Attributes:
        profile: (2 COLUMNS, m) whitened mean over the rows at each column, along x and then along y, from coefficients of the distortion.
        begin: exponentials at the row start, by length.
        end: exponentials at the row end, by length.
    """

    profile: Array
    begin: tuple[_Template, ...]
    end: tuple[_Template, ...]

    @classmethod
    def of(cls, solution: Solution, covariance: Array, field: DistortionField) -> RowStartFit:
        """The fit for the distortion of a solution, with its covariance (m, m), over the calibrated part of its grid."""
        spline, shrinkage = solution.state.distortion, covariance @ solution.distortion_prior()
        columns, rows = (np.flatnonzero(field.valid.any(axis=axis)) for axis in (0, 1))
        x = np.linspace(field.grid.x_px[columns[0]], field.grid.x_px[columns[-1]], COLUMNS)
        mean = np.kron(_along(spline.along_y, field.grid.y_px[rows]).mean(axis=0), _along(spline.along_x, x))
        profile = np.zeros((2 * COLUMNS, spline.size))
        for axis in (0, 1):
            profile[axis * COLUMNS : (axis + 1) * COLUMNS, axis::2] = mean
        size, vectors = np.linalg.eigh(profile @ covariance @ profile.T)
        whiten = (vectors / np.sqrt(np.maximum(size, 1e-6 * size[-1]))).T
        scaled = (x - x[0]) / np.ptp(x)
        base = whiten @ np.kron(np.eye(2), np.stack([scaled**power for power in range(POLYNOMIALS)], axis=-1))
        whitened, frame_px = whiten @ profile, np.arange(field.grid.x_px[0] + field.grid.x_px[-1] + 1.0)

        def template(start_px: float, length_px: float) -> _Template:
            exponential = _exponential(spline, frame_px, start_px, length_px)
            removed = exponential @ shrinkage.T
            return _Template(float(abs(length_px)), np.hstack((base, whitened @ (exponential - removed).T)), removed)

        lengths = np.geomspace(SHORTEST_PX, LONGEST_SHARE * np.ptp(x), LENGTHS)
        begin, end = (tuple(template(at, sign * length) for length in lengths) for at, sign in ((x[0], 1.0), (x[-1], -1.0)))
        return cls(whitened, begin, end)

    def found(self, mean: Array) -> RowStart | None:
        """Settling at the row start in a distortion (m,); None if not significant.

        One magnification and one dwell do not separate the laws in time and in position (`semlive experiment row-start`).
        """
        data = (self.profile @ mean)[:, None]
        fits = [(float(misfit[0]), template, amplitude[:, 0]) for template in self.begin for misfit, amplitude in [template.fit(data)]]
        misfit, best, (along_x, along_y) = min(fits, key=lambda fit: fit[0])
        at_end = min(float(template.fit(data)[0][0]) for template in self.end)
        # The longest length without an optimum below it is a smooth distortion: that of the paper gained 264 so, without settling.
        longest = best is self.begin[-1]
        # Both gains are over the polynomials alone.
        if longest or at_end - misfit < max(MIN_GAIN, MIN_GAIN_PER_MISFIT * misfit):
            return None
        return RowStart((float(along_x), float(along_y)), best.length_px)

    def removed(self, draws: Array) -> Array:
        """(d, m) what the prior removed from the settling of each distortion (d, m), each with its own amplitude and length."""
        data = self.profile @ draws.T
        misfits, amplitudes = (np.stack(each) for each in zip(*(template.fit(data) for template in self.begin), strict=True))
        best = np.argmin(misfits, axis=0)
        amplitude = amplitudes[best, :, np.arange(len(draws))]
        return np.einsum("da,dam->dm", amplitude, np.stack([template.removed for template in self.begin])[best])


def basis_of(spline: DistortionSpline, x_px: Array, y_px: Array) -> Array:
    """(n, k) values of the basis functions of one component at points (n,)."""
    along_x, along_y = (_along(axis, points) for axis, points in ((spline.along_x, x_px), (spline.along_y, y_px)))
    return np.einsum("nj,ni->nji", along_y, along_x).reshape(len(x_px), -1)


def _along(axis: UniformSpline | KnotSpline, at_px: Array) -> Array:
    """(n, k) values of the basis functions along one axis."""
    index, value = axis.local(at_px)
    found = np.zeros((len(at_px), axis.size))
    np.put_along_axis(found, index, value, axis=1)
    return found


def _exponential(spline: DistortionSpline, x_px: Array, start_px: float, length_px: float) -> Array:
    """(2, m) coefficients of an exponential along x, equal in all rows, that is 1 px at a column: displacement along x, and along y."""
    along_x = np.linalg.lstsq(_along(spline.along_x, x_px), np.exp(-(x_px - start_px) / length_px), rcond=None)[0]
    component = np.tile(along_x, spline.along_y.size)  # basis functions add up to 1
    return np.asarray([np.kron(component, unit) for unit in np.eye(2)], dtype=np.float64)
