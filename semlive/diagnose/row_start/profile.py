"""Displacement at the start of a row (or frame) at one pixel size and scan speed: one exponential, or the sum of two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]
LENGTHS = 24  # starting values of the length, from two pixels to twice the range
SEPARATION = 1.5  # smallest ratio of two lengths


@dataclass(frozen=True, slots=True, eq=False)
class RowStartProfile:
    """Measured displacement over the distance from the start.

    Attributes:
        pixel_nm: pixel size, nm.
        pixel_s: time from pixel to pixel along the profile: the dwell time along rows, the row time along columns, s.
        distance_px: (n,) distance from the start, px.
        shift_px: (n,) displacement, px.
        sigma_px: (n,) standard uncertainty, px.
    """

    pixel_nm: float
    pixel_s: float
    distance_px: Array
    shift_px: Array
    sigma_px: Array


@dataclass(frozen=True, slots=True, eq=False)
class FittedProfile:
    """Exponentials fitted to a profile, plus a constant.

    Attributes:
        profile: the profile.
        amplitude_px: (k,) amplitudes at the start, px; the shortest length first.
        length_px: (k,) lengths, px.
        covariance: (2 k, 2 k) covariance of the logarithms of the amplitudes and of the lengths.
        chi2: sum of the squared residuals in units of their uncertainty.
    """

    profile: RowStartProfile
    amplitude_px: Array
    length_px: Array
    covariance: Array
    chi2: float

    @property
    def terms(self) -> int:
        """Number of exponentials."""
        return len(self.length_px)

    @property
    def logarithms(self) -> Array:
        """(2 k,) logarithms of the absolute amplitudes and of the lengths."""
        return np.log(np.concatenate((np.abs(self.amplitude_px), self.length_px)))

    @property
    def significance(self) -> float:
        """Smallest amplitude in units of its standard uncertainty."""
        return float(1.0 / np.sqrt(np.diag(self.covariance)[: self.terms].max()))


def fit_profile(profile: RowStartProfile, terms: int) -> FittedProfile | None:
    """Fit one or two exponentials and a constant; None if the profile does not determine them.

    Amplitudes and constant are linear and eliminated; lengths start from the best of a grid.
    """
    x, sigma = profile.distance_px, profile.sigma_px
    grid = np.geomspace(2.0, 2.0 * float(np.ptp(x)) + 2.0, LENGTHS)
    starts = [(length,) for length in grid]
    if terms == 2:
        starts = [(a, b) for a in grid for b in grid if b > SEPARATION * a]
    start = min(starts, key=lambda lengths: _chi2(profile, np.array(lengths)))
    amplitudes = _linear(profile, np.array(start))[0]

    def misfit(parameters: Array) -> Array:
        decay = np.exp(-np.divide.outer(x, np.exp(parameters[terms + 1 :])))
        return np.asarray((decay @ parameters[:terms] + parameters[terms] - profile.shift_px) / sigma)

    first = np.concatenate((amplitudes, np.log(start)))
    low, high = np.full(len(first), -np.inf), np.full(len(first), np.inf)
    low[terms + 1 :], high[terms + 1 :] = np.log(0.2 * grid[0]), np.log(5.0 * grid[-1])
    found = least_squares(misfit, first, bounds=(low, high), x_scale="jac")
    order = np.argsort(found.x[terms + 1 :])
    amplitude, length = found.x[:terms][order], np.exp(found.x[terms + 1 :][order])
    normal = found.jac.T @ found.jac
    if not amplitude.all() or np.linalg.cond(normal) > 1e14 or (terms == 2 and length[1] < SEPARATION * length[0]):
        return None
    place = np.concatenate((order, terms + 1 + order))
    scale = np.concatenate((amplitude, np.ones(terms)))
    covariance = np.linalg.inv(normal)[np.ix_(place, place)] / np.outer(scale, scale)
    return FittedProfile(profile, amplitude, length, covariance, float(np.sum(misfit(found.x) ** 2)))


def _linear(profile: RowStartProfile, lengths: Array) -> tuple[Array, float]:
    columns = np.column_stack((np.exp(-np.divide.outer(profile.distance_px, lengths)), np.ones(len(profile.distance_px))))
    weighted = columns / profile.sigma_px[:, None]
    data = profile.shift_px / profile.sigma_px
    solution = np.asarray(np.linalg.lstsq(weighted, data, rcond=None)[0], dtype=np.float64)
    return solution, float(np.sum((weighted @ solution - data) ** 2))


def _chi2(profile: RowStartProfile, lengths: Array) -> float:
    return _linear(profile, lengths)[1]
