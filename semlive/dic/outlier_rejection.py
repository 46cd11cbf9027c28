"""Outlier rejection: status of each converged point from the complete map.

IC-GN converges wherever a subset resembles the reference: at a partly covered subset, at the edge of a blank area, across a crack. ZNCC
alone does not detect this, because it depends on noise and contrast. Four criteria are used.

- Residual. If the model is valid, the residual is noise, within 15 % of the usual value of the map in 10^5 fully visible subsets. A
  subset that is partly covered, or moves in two ways, has a larger residual.
- Discontinuity. A subset across a crack of width J converts the jump into a strain of 1.5 J / subset, which points at a distance of
  half a subset do not have.
- Neighbours. A point with usual residual, uncertainty and contrast is trusted. Other points must agree with a plane through the
  trusted points around them.
- Clusters. Points that agree with no neighbours are rejected.

With strong noise, the residual does not show an edge within a subset, and the map bends smoothly towards it (0.6 px at the edge,
0.4 px one point further, at noise of 20 grey levels and contrast of 39). In this case the outermost valid points are rejected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from semlive.data.disparity import PoiStatus
from semlive.data.grid import Grid
from semlive.kernels.local_planes import fit_local_planes
from semlive.kernels.motion_clusters import cluster_sizes
from semlive.kernels.order_statistics import median_of, percentiles_of, ptp_columns

MAX_RESIDUAL_RATIO = 1.22  # to the usual residual of the map; the largest of 10^5 good points was 1.15
RESIDUAL_NEEDING_SUPPORT = 1.1  # exceeded by one good point in a thousand, which then must agree with its neighbours
MAX_SPREAD = 0.25  # relative scatter of the residual of good subsets: 3.5 % for white noise, 25 % if the pattern changes
PLAIN_MISFIT = 0.5  # fraction of MISFIT that needs no confirmation by neighbours
MISFIT = 0.015  # of the variance of the speckle: residual of saturation, curvature and interpolation
CONFIRMED_MISFIT = 0.06  # of the variance of the speckle, accepted if neighbours agree: 3 % of a subset saturated in one frame
ORDINARY_SIGMA = 1.2  # times the median of the map; with noise of 20 grey levels wrong points start at 1.22
SPREADING_SIGMA = 1.35  # above, neighbours can confirm a point, but the point cannot confirm others
WEAK_SIGMA = 2.5  # above, too little of the subset is visible for a measurement
NOISE_SIGMA_PX = 3.3  # / subset: stated sigma of a subset without speckle, whose gradients are noise
SAFE_SIGMA = 0.35  # of that: certainly not blank; wrong points start at 0.42
EXCESS_PX = 30.0  # / subset: relative variance above the median, of an edge that hides speckle; small subsets scatter more
JUMP_PX = 0.75  # causes half this error at the centre; with 0.9, 82 of 10^6 points at cracks were wrong with noise of 20 grey levels
SIGMAS = 3.0
DISCONTINUITY_NEIGHBOURS = 4  # of eight neighbours at a discontinuity; a point with as many is rejected, too
REJECTED_NEIGHBOURS = 4  # of eight; a point between them lies across a crack or a corner of a blank area and cannot be confirmed
AGREES_PX = 0.08  # plus the usual sigma, for affine subsets of REFERENCE_SUBSET_PX; scaled for smaller and second-order ones
BENDS_PX = 0.4  # deviation of the slope at the edge of the subset, scaled likewise
REFERENCE_SUBSET_PX = 43.0
QUADRATIC_NOISE_RATIO = 2.0  # noise of second-order subsets relative to affine ones
MAX_HALF_WIDTH = 4  # points on each side for the fit of a plane, within half a subset
MIN_SUPPORT = 0.15  # smallest fraction of trusted points around a point
MIN_LINES = 3  # lines of points that determine a slope
MIN_TRUSTED_FRACTION = 0.5  # of trusted points around, to accept a larger residual; at a crack the fraction is smaller
MIN_TRUSTED_FRACTION_FAR = 0.65  # within twice the distance: 0.79 at a single grain, 0.54 at a crack
LINK_TOLERANCE_PX = 0.6  # difference of linked points after subtraction of their strain
MIN_CLUSTER_SIZE = 6
MAX_ROUNDS = 200
HIGH_NOISE_VARIANCE = 0.15  # relative to the speckle; above, the residual does not show the edge of a blank area
EDGE_NEIGHBOURS = 3  # of eight neighbours rejected: edge of the valid area
EDGES = np.zeros(256, dtype=np.bool_)  # by status: the point makes its neighbours an edge
EDGES[[PoiStatus.NOT_CONVERGED, PoiStatus.LOW_ZNCC, PoiStatus.LOW_CONTRAST, PoiStatus.NO_SEED]] = True


@dataclass(frozen=True, slots=True, eq=False)
class PointMeasurements:
    """Measurements of each point of a map, arrays of (ny, nx).

    Attributes:
        u_px: displacement along x.
        v_px: displacement along y.
        gradient: (ny, nx, 4) du/dx, du/dy, dv/dx, dv/dy.
        sigma_u_px: standard uncertainty of u.
        sigma_v_px: standard uncertainty of v.
        covariance_px2: covariance of u and v.
        zncc: zero-normalised cross-correlation.
        residual: noise variance of one frame from the residual, grey^2.
        contrast: variance of the reference subset, noise included, grey^2.
        status: PoiStatus after IC-GN.
        iterations: iterations of the last attempt.
        length: length of the texture in subsets, standard deviation over smallest root mean square derivative, noise subtracted.
    """

    u_px: NDArray[np.float64]
    v_px: NDArray[np.float64]
    gradient: NDArray[np.float32]
    sigma_u_px: NDArray[np.float64]
    sigma_v_px: NDArray[np.float64]
    covariance_px2: NDArray[np.float64]
    zncc: NDArray[np.float64]
    residual: NDArray[np.float32]
    contrast: NDArray[np.float32]
    status: NDArray[np.uint8]
    iterations: NDArray[np.int32]
    length: NDArray[np.float32]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Where IC-GN converged."""
        return self.status == PoiStatus.CONVERGED

    @property
    def sigma_px(self) -> NDArray[np.float64]:
        """The larger standard uncertainty of u and v."""
        return np.maximum(self.sigma_u_px, self.sigma_v_px)


def rejection_status(measured: PointMeasurements, grid: Grid, *, curved: bool = False) -> NDArray[np.uint8]:
    """Return (ny, nx) PoiStatus: CONVERGED for accepted and for previously invalid points, else the reason of rejection.

    Args:
        measured: measurements of the map.
        grid: grid of the points.
        curved: whether the shape function has second order.
    """
    m = measured
    valid, sigma_px = m.valid, m.sigma_px
    verdict = np.full(valid.shape, PoiStatus.CONVERGED, dtype=np.uint8)
    if not valid.any():
        return verdict
    low, mid = percentiles_of(m.residual[valid], 10, 35)
    spread = min((mid - low) / 0.9, MAX_SPREAD * mid)  # standard deviation of the lower part, which contains no hidden subsets
    ordinary = mid + 0.4 * spread
    contrast = float(median_of(m.contrast[valid]))
    misfit = MISFIT * max(contrast - ordinary, 0.0)
    limit = max(MAX_RESIDUAL_RATIO * ordinary, ordinary + 6.0 * spread, ordinary + misfit)
    fits = valid & (m.residual <= limit)
    verdict[valid & ~fits] = PoiStatus.LOW_ZNCC
    safe = SAFE_SIGMA * NOISE_SIGMA_PX / grid.subset_px
    excusable = valid & ~fits & (m.residual <= ordinary + CONFIRMED_MISFIT * max(contrast - ordinary, 0.0))
    sigma = float(median_of(sigma_px[fits]))
    sound = fits & (sigma_px <= max(SPREADING_SIGMA * sigma, safe))
    discontinuous = _discontinuous(m, fits | excusable, sound, grid)
    if discontinuous.any():
        verdict[discontinuous & fits] = PoiStatus.INCONSISTENT
        fits &= ~discontinuous
        excusable &= ~discontinuous
        if not fits.any():
            return verdict
        sigma = float(median_of(sigma_px[fits]))
    signal = m.contrast - ordinary
    usual_signal = float(median_of(signal[fits]))
    usual_points = fits & (sigma_px <= max(ORDINARY_SIGMA * sigma, safe)) & (signal <= (1.0 + EXCESS_PX / grid.subset_px) * usual_signal)
    usual_points &= m.residual <= max(RESIDUAL_NEEDING_SUPPORT * ordinary, ordinary + 3.0 * spread, ordinary + PLAIN_MISFIT * misfit)
    trusted = usual_points & ~_isolated(m, usual_points, grid)
    weak = fits & (sigma_px > max(WEAK_SIGMA * sigma, safe))
    verdict[weak] = PoiStatus.LOW_CONTRAST
    suspect = fits & ~trusted & ~weak
    surrounded = _marked_neighbours(valid & ~fits & ~excusable) >= REJECTED_NEIGHBOURS
    excusable &= sigma_px <= max(WEAK_SIGMA * sigma, safe)
    if suspect.any() or excusable.any():
        accepted = _confirmed(
            m, trusted, suspect & ~surrounded, excusable, fits & (sigma_px <= max(SPREADING_SIGMA * sigma, safe)), grid, curved
        )
        verdict[suspect & ~accepted] = PoiStatus.INCONSISTENT
        verdict[excusable & accepted] = PoiStatus.CONVERGED
    invalid = (verdict != PoiStatus.CONVERGED) | EDGES[m.status]
    if not invalid.any():
        return verdict
    neighbours = _marked_neighbours(invalid)
    if ordinary > HIGH_NOISE_VARIANCE * (contrast - ordinary):
        edge = neighbours >= EDGE_NEIGHBOURS
    else:
        edge = (neighbours >= REJECTED_NEIGHBOURS) & (sigma_px > WEAK_SIGMA * sigma)  # weak, but below the safe limit
    verdict[valid & ~invalid & edge] = PoiStatus.INCONSISTENT
    return verdict


def _discontinuous(m: PointMeasurements, candidates: NDArray[np.bool_], sound: NDArray[np.bool_], grid: Grid) -> NDArray[np.bool_]:
    """Points at a discontinuity: the slope across the subset differs from those at half a subset and one subset on both sides.

    Args:
        m: measurements of the map.
        candidates: points to test.
        sound: points to compare with.
        grid: grid of the points.
    """
    span = ptp_columns(m.gradient.reshape(-1, 4)) * (grid.subset_px / 1.5)
    if max(np.hypot(span[0], span[2]), np.hypot(span[1], span[3])) <= JUMP_PX:
        return np.zeros(sound.shape, dtype=bool)  # no two slopes differ enough
    jump = np.zeros(sound.shape)
    displacement = np.stack([m.u_px, m.v_px], axis=-1)
    for distance in (0.5, 1.0):
        steps = max(1, round(distance * grid.subset_px / grid.step_px))
        for axis in range(2):
            slope = m.gradient[..., axis::2]  # du/dx and dv/dx change along x
            available = {direction: _shifted(sound, direction * steps, axis) for direction in (-1, 1)}
            slopes = {direction: _shifted(slope, direction * steps, axis) for direction in (-1, 1)}
            smallest = np.full(sound.shape, np.inf)
            for direction in (-1, 1):
                excess = np.linalg.norm(slope - slopes[direction], axis=-1) * (grid.subset_px / 1.5)
                smallest = np.where(available[direction], np.minimum(smallest, excess), smallest)
            # A wave with the length of a subset has such slopes, too, but no step.
            ramp = (slopes[-1] + slopes[1]) * (steps * grid.step_px)
            step = np.linalg.norm(_shifted(displacement, steps, axis) - _shifted(displacement, -steps, axis) - ramp, axis=-1)
            smallest = np.where(available[-1] & available[1], np.minimum(smallest, step), smallest)
            jump = np.maximum(jump, np.where(np.isfinite(smallest), smallest, 0.0))
    discontinuous = candidates & (jump > np.maximum(JUMP_PX, SIGMAS * 4.0 * m.sigma_px))
    return discontinuous | (candidates & (_marked_neighbours(discontinuous) >= DISCONTINUITY_NEIGHBOURS))


def _marked_neighbours(marked: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Number of marked points among a point and its eight neighbours."""
    if not marked.any():
        return np.zeros(marked.shape, dtype=np.uint8)
    return np.asarray(ndimage.convolve(marked.astype(np.uint8), np.ones((3, 3), np.uint8), mode="constant"), dtype=np.uint8)


def _shifted(values: NDArray, steps: int, axis: int) -> NDArray:
    """Values at a distance of `steps` points along x (axis 0) or y (axis 1), zero outside the map."""
    out = np.zeros_like(values)
    dim = 1 - axis
    n = values.shape[dim]
    if abs(steps) >= n:
        return out
    to, source = [slice(None)] * 2, [slice(None)] * 2
    to[dim] = slice(max(-steps, 0), n - max(steps, 0))
    source[dim] = slice(max(steps, 0), n - max(-steps, 0))
    out[tuple(to)] = values[tuple(source)]
    return out


def _isolated(m: PointMeasurements, plain: NDArray[np.bool_], grid: Grid) -> NDArray[np.bool_]:
    """Plain points in clusters of fewer than MIN_CLUSTER_SIZE agreeing points."""
    size = cluster_sizes(m.u_px, m.v_px, m.gradient, m.sigma_px, plain, 0.5 * grid.step_px, LINK_TOLERANCE_PX)
    return plain & (size < min(MIN_CLUSTER_SIZE, plain.size))


def _confirmed(
    m: PointMeasurements,
    trusted: NDArray[np.bool_],
    suspect: NDArray[np.bool_],
    excusable: NDArray[np.bool_],
    spreading: NDArray[np.bool_],
    grid: Grid,
    curved: bool,
) -> NDArray[np.bool_]:
    """Suspect points that agree with a plane through the trusted points around; confirmed points become trusted.

    Excusable points, with a larger residual, need more trusted points around, and do not become trusted. A local cause of a larger
    residual, such as a grain that is saturated in one frame, affects every subset that contains it. The central ones have trusted
    points only at a larger distance; therefore twice the half width is used for them.
    """
    trusted = trusted.copy()
    accepted = np.zeros(suspect.shape, dtype=bool)
    half_width = int(np.clip(round(grid.subset_px / 2 / grid.step_px), 1, MAX_HALF_WIDTH))
    determined = np.array([grid.nx >= MIN_LINES, grid.ny >= MIN_LINES] * 2)  # slopes that the points determine
    scale = max(REFERENCE_SUBSET_PX / grid.subset_px, 1.0)
    agrees_px, bends_px = AGREES_PX * scale * (QUADRATIC_NOISE_RATIO if curved else 1.0), BENDS_PX * scale
    tolerance = agrees_px + np.where(spreading, m.sigma_px, 0.5 * np.median(m.sigma_px[trusted]) if trusted.any() else 0.0)
    u_px, v_px = (np.ascontiguousarray(value, dtype=np.float64) for value in (m.u_px, m.v_px))

    def agreeing(near: NDArray[np.bool_], half_width: int, part: NDArray[np.float64] | float) -> NDArray[np.bool_]:
        """Points of `near` that agree with the trusted points within `half_width`, if these are a sufficient fraction there."""
        count = min(2 * half_width + 1, grid.ny) * min(2 * half_width + 1, grid.nx)
        u, v, slope, support = fit_local_planes(u_px, v_px, trusted, near, half_width)
        distance = np.hypot(u_px[near] - u, v_px[near] - v)
        bent = np.linalg.norm((m.gradient[near] - slope / grid.step_px) * determined, axis=-1) * (grid.subset_px // 2)
        agree = np.zeros(suspect.shape, dtype=bool)
        agree[near] = (support >= np.maximum(3.0, part * count)) & (distance <= tolerance[near]) & (bent <= bends_px)
        return agree

    near = pending = suspect | excusable
    for _ in range(MAX_ROUNDS):
        confirmed = agreeing(near, half_width, np.where(excusable[near], MIN_TRUSTED_FRACTION, MIN_SUPPORT))
        accepted |= confirmed
        added = confirmed & spreading & ~trusted
        if not added.any():
            break
        trusted |= added
        # other points have the same trusted neighbours as before
        reached = np.asarray(ndimage.maximum_filter(added, 2 * half_width + 1, mode="constant"), dtype=bool)
        near = pending & ~accepted & reached
    rejected = excusable & ~accepted
    return accepted | agreeing(rejected, 2 * half_width, MIN_TRUSTED_FRACTION_FAR) if rejected.any() else accepted
