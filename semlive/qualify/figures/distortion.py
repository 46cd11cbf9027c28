"""Distortion: largest value, and false strain per pixel of shift, with draws of the posterior of the joint estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import CalibrationQuality, DistortionField
from semlive.estimate import Solution
from semlive.qualify.figures.intervals import TAILS, Interval, quantiles, widened
from semlive.qualify.figures.row_start import RowStart, RowStartFit, basis_of
from semlive.qualify.values import Figure, Result, Undetermined

Array = NDArray[np.float64]
POINTS = 13
"""Points along each axis at which the field is drawn: closer together than the knots of the spline in frames of up to 1300 px."""
HALF_SHIFT_PX = 4.0
ROW_POLYNOMIALS = 6
"""Polynomials of the row, from the second order on, that the distortion follows, each with the uncertainty of a mean: vibration of 0.36 px
made the largest distortion 0.09 px too large, jitter of 0.31 px 0.06 px.
"""
MIN_COVERED = 0.5
DRAWS = 1000
PLACE_SIGMAS = 3.0
"""Standard uncertainties below the strain at a place that none of a hundred independent places exceeds in 90 % of cases."""
SHIFTS = ((HALF_SHIFT_PX, 0.0), (0.0, HALF_SHIFT_PX))


@dataclass(frozen=True, slots=True, eq=False)
class DistortionDraws:
    """Draws of the distortion.

    Attributes:
        largest_px: largest length of the distortion, affine part removed, with its interval.
        strain_per_px: largest false strain of a gauge per px of shift, over exx, eyy, exy, both shifts and all places, with its interval.
        sigma_per_px: standard uncertainty of one such strain, root mean square.
        settling: settling at the row start, which is part of the distortion; None if it is not significant.
    """

    largest_px: Interval
    strain_per_px: Interval
    sigma_per_px: float
    settling: RowStart | None


def sample_points(field: DistortionField, margin_px: float) -> tuple[Array, Array]:
    """(n,) columns and rows of points spread over the calibrated part of the grid, `margin_px` inside its edges."""
    ys, xs = np.nonzero(field.valid)
    grid = field.grid
    x = np.linspace(grid.x_px[xs.min()] + margin_px, grid.x_px[xs.max()] - margin_px, POINTS)
    y = np.linspace(grid.y_px[ys.min()] + margin_px, grid.y_px[ys.max()] - margin_px, POINTS)
    mesh_x, mesh_y = np.meshgrid(x, y)
    return mesh_x.ravel(), mesh_y.ravel()


def without_affine(values: Array, x_px: Array, y_px: Array) -> Array:
    """(n, ...) values without their best affine map over the points (n,), which a calibration by translations does not determine."""
    columns = np.column_stack((np.ones(len(x_px)), x_px - x_px.mean(), y_px - y_px.mean()))
    return values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]


def gauge_strain_per_px(field_at: Array, gauge_px: float) -> Array:
    """(n, 3, 2) exx, eyy, exy per px of shift along x and along y, from the field (16, n, 2) at the points of `stencil`."""
    change = (field_at[0::2] - field_at[1::2]) / (2.0 * HALF_SHIFT_PX)
    # For each shift: right, left of, below and above the centre of the gauge.
    by_shift = change.reshape(2, 4, *field_at.shape[1:])
    along_x = (by_shift[:, 0] - by_shift[:, 1]) / gauge_px
    along_y = (by_shift[:, 2] - by_shift[:, 3]) / gauge_px
    strain = np.stack((along_x[..., 0], along_y[..., 1], 0.5 * (along_y[..., 0] + along_x[..., 1])), axis=-1)
    return np.moveaxis(strain, 0, -1)


def stencil(x_px: Array, y_px: Array, gauge_px: float) -> list[tuple[Array, Array]]:
    """Columns and rows at which the field is evaluated: for each shift, both ends of the gauge along x and y, shifted forth and back."""
    half = 0.5 * gauge_px
    ends = ((half, 0.0), (-half, 0.0), (0.0, half), (0.0, -half))
    return [(x_px + end[0] + sign * shift[0], y_px + end[1] + sign * shift[1]) for shift in SHIFTS for end in ends for sign in (1.0, -1.0)]


def draw_distortion(solution: Solution, field: DistortionField, gauge_px: float) -> DistortionDraws:
    """Draw the distortion from its posterior, and derive both figures from each draw.

    What the prior removes from a significant settling at the row start is added to each draw.
    """
    spline = solution.state.distortion
    covariance = solution.distortion_covariance()
    size, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(size, 0.0))
    rng = np.random.default_rng(4)
    parameters = np.vstack((solution.part("distortion"), solution.part("distortion") + rng.standard_normal((DRAWS, spline.size)) @ root.T))
    fit = RowStartFit.of(solution, covariance, field)
    settling = fit.found(parameters[0])
    if settling is not None:
        parameters = parameters + fit.removed(parameters)
    outer = sample_points(field, 0.0)
    inner = sample_points(field, 0.5 * gauge_px + HALF_SHIFT_PX)
    # The basis is evaluated once: field by field, 1001 draws at 17 sets of points took 5 s.
    coefficients = parameters.reshape(len(parameters), -1, 2)
    drawn = np.moveaxis(basis_of(spline, *outer) @ coefficients, 0, 1)
    largest = np.linalg.norm(without_affine(drawn.reshape(len(drawn), -1), *outer).reshape(drawn.shape), axis=2).max(axis=0)
    x, y = np.moveaxis(np.array(stencil(*inner, gauge_px)), 1, 0)
    basis = basis_of(spline, x.ravel(), y.ravel())
    strains = np.stack([gauge_strain_per_px((basis @ each).reshape(*x.shape, 2), gauge_px).ravel() for each in coefficients])
    sigma = float(np.sqrt(np.mean(strains[1:].var(axis=0))))
    # Draws of the largest of 1014 strains exceed the true one where noise and strain are of one size: their quantiles held it in 11 of 30
    # simulated microscopes. The lower end is therefore that of the strains one by one.
    size, spread = np.abs(strains[0]), strains[1:].std(axis=0)
    low = max(float(np.max(size - PLACE_SIGMAS * spread)), 0.0)
    return DistortionDraws(
        largest_interval(largest), (float(size.max()), low, float(np.quantile(np.abs(strains[1:]).max(axis=1), TAILS[1]))), sigma, settling
    )


def largest_interval(largest: Array) -> Interval:
    """Interval of a largest length from that of the mean field, followed by those of draws (d,).

    Noise makes the largest length of a draw larger than that of the mean field, and that larger than the true one. The lower end is
    therefore as far below the value as the upper end above it: with a distortion of 0.02 px, far below the noise, quantiles of the draws
    contained the truth in 1 of 16 simulated microscopes, this interval in 15; with 2 px both are equal. It relies on the smoothness of the
    posterior: the noise of hundreds of independent places would exceed both ends.
    """
    value, (_, low, high) = float(largest[0]), quantiles(largest[1:])
    return value, max(min(low, 2.0 * value - high), 0.0), high


def distortion_results(
    solution: Solution, field: DistortionField, quality: CalibrationQuality | None, gauge_px: float, bias_px: float = 0.0
) -> tuple[list[Result], DistortionDraws | None]:
    """Largest distortion and false strain per px of shift, or why they are not determined.

    Args:
        solution: of the joint estimate.
        field: the distortion.
        quality: whether it is determined.
        gauge_px: gauge of the false strain.
        bias_px: standard uncertainty of a mean over the maps beyond their noise.
    """
    remedy = "shift the specimen or the beam along x and along y by 3 % of the frame, to both sides, and take a pair at each place"
    if quality is None or quality.refused or quality.covered < MIN_COVERED or not field.valid.any():
        reason = "the frames are not shifted along both axes" if quality is None or not quality.refused else quality.refused
        return [Undetermined("distortion", reason, remedy)], None
    if min(np.ptp(axis) for axis in sample_points(field, 0.0)) < 2.0 * gauge_px + 4.0 * HALF_SHIFT_PX:
        return [
            Undetermined("distortion", "the calibrated part of the frame is smaller than two gauges", "use a larger frame", by_pairs=False)
        ], None
    draws = draw_distortion(solution, field, gauge_px)
    largest = widened(draws.largest_px, np.sqrt(ROW_POLYNOMIALS) * bias_px)
    note = f"largest over the calibrated part of the frame, gauge of {gauge_px:.0f} px"
    return [
        Figure("distortion", "largest distortion", *largest, "px", note="without its affine part"),
        Figure("false_strain_per_px", "false strain per px of shift, not corrected", *draws.strain_per_px, "1/px", note=note),
    ], draws
