"""Converged is not yet right: what a whole map says about each of its points.

IC-GN converges wherever a subset resembles the reference: on the half of a subset that is not covered, on the edge of a blank
area, on both sides of a crack at once. ZNCC alone does not tell, for it depends on noise and contrast. Four things do.

- The residual. It is noise wherever the model holds, within 15 % of the map's ordinary in 10^5 fully visible subsets; a subset
  of which a part is covered or moved otherwise leaves more.
- The jump. A subset across a crack of width J turns the jump into strain 1.5 J / subset, which points half a subset away lack.
- The neighbours. A point that is ordinary in residual, uncertainty and contrast is trusted; one that is not has to agree
  with a plane through the trusted around it.
- Company. Points that agree with nobody around are not believed.

Where noise is strong, an edge within a subset does not show in its residual, and bends the map smoothly towards it (0.6 px at the
edge, 0.4 px a point further, at 20 grey levels of noise on 39 of contrast). There the outermost points of what is believed are not.
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

ORDINARY_RESIDUAL = 1.22  # times the map's ordinary; 15 % above was the most in 10^5 good points
RESIDUAL_NEEDING_SUPPORT = 1.1  # one good point in a thousand is above and has to agree with its neighbours
MAX_SPREAD = 0.25  # of the residual among good subsets; white noise scatters by 3.5 %, a pattern that changes by 25 %
PLAIN_MISFIT = 0.5  # part of it that asks for no confirmation
MISFIT = 0.015  # of the speckle's variance: saturation, curvature and interpolation leave as much
CONFIRMED_MISFIT = 0.06  # part of it that neighbours may excuse: where one frame alone is saturated 3 % of a subset leave as much
ORDINARY_SIGMA = 1.2  # times the map's median; at 20 grey of noise wrong points begin at 1.22
SPREADING_SIGMA = 1.35  # beyond, a point is told by its neighbours but tells nothing to others
WEAK_SIGMA = 2.5  # beyond, too little of the subset is left to tell anything
NOISE_SIGMA_PX = 3.3  # / subset: the stated sigma of a subset without speckle, whose gradients are noise alone
SAFE_SIGMA = 0.35  # of that: far from blank, whatever the rest of the map; wrong points begin at 0.42
EXCESS_PX = 30.0  # / subset: variance above the map's median, of an edge, which hides speckle; small subsets scatter more
JUMP_PX = 0.75  # makes the subset's centre wrong by half as much; at 0.9, 82 of 10^6 points beside cracks were wrong at 20 grey
SIGMAS = 3.0
DISCONTINUITY_NEIGHBOURS = 4  # of eight neighbours: a point among such is torn too
REJECTED_NEIGHBOURS = 4  # of eight: what is left between them bridges a crack or a corner of a blank area; others would be told by it
AGREES_PX = 0.08  # and once the ordinary sigma, for affine subsets of TOLD_PX; smaller ones and second order are noisier in proportion
BENDS_PX = 0.4  # at the subset's edge, likewise
REFERENCE_SUBSET_PX = 43.0
QUADRATIC_NOISE_RATIO = 2.0  # of second-order subsets, in that of affine ones
MAX_REACH = 4  # points on each side that a plane is fitted to, within half a subset
MIN_SUPPORT = 0.15  # part of the points around that has to be trusted
MIN_LINES = 3  # of points that a slope across them is told from
MIN_TRUSTED_FRACTION = 0.5  # part of them that has to be trusted to excuse a residual; along a crack it is less
MIN_TRUSTED_FRACTION_FAR = 0.65  # within twice as far, where a single grain leaves 0.79 and a crack 0.54
LINKS_PX = 0.6  # apart, after each other's strain
MIN_CLUSTER_SIZE = 6
MAX_ROUNDS = 200
HIGH_NOISE_VARIANCE = 0.15  # variance of noise, in the speckle's: from there on it hides what the edge of a blank area does to a residual
EDGE_AROUND = 3  # of eight neighbours refused: the edge of what is believed
EDGES = np.zeros(256, dtype=np.bool_)  # at each status: of a subset with others nearby
EDGES[[PoiStatus.NOT_CONVERGED, PoiStatus.LOW_ZNCC, PoiStatus.LOW_CONTRAST, PoiStatus.NO_SEED]] = True


@dataclass(frozen=True, slots=True, eq=False)
class PointMeasurements:
    """What is known of each point of a map, (ny, nx) each.

    Attributes:
        u_px: displacement along x.
        v_px: displacement along y.
        gradient: (ny, nx, 4) du/dx, du/dy, dv/dx, dv/dy.
        sigma_u_px: standard uncertainty of u.
        sigma_v_px: of v.
        covariance_px2: of u and v.
        zncc: correlation.
        residual: noise variance of one frame as the residual has it, grey^2.
        contrast: variance of the reference subset, noise included, grey^2.
        status: PoiStatus as IC-GN left it.
        iterations: of the last attempt.
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

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Where IC-GN converged."""
        return self.status == PoiStatus.CONVERGED

    @property
    def sigma_px(self) -> NDArray[np.float64]:
        """The larger standard uncertainty of u and v."""
        return np.maximum(self.sigma_u_px, self.sigma_v_px)


def rejection_status(measured: PointMeasurements, grid: Grid, *, curved: bool = False) -> NDArray[np.uint8]:
    """(ny, nx) PoiStatus: CONVERGED where a point is believed, else why not (CONVERGED too where it was not valid before).

    Args:
        measured: the map.
        grid: its points.
        curved: whether the shape function is one of second order.
    """
    m = measured
    valid, sigma_px = m.valid, m.sigma_px
    verdict = np.full(valid.shape, PoiStatus.CONVERGED, dtype=np.uint8)
    if not valid.any():
        return verdict
    low, mid = percentiles_of(m.residual[valid], 10, 35)
    spread = min((mid - low) / 0.9, MAX_SPREAD * mid)  # standard deviation, of the lower part, which nothing hidden is in
    ordinary = mid + 0.4 * spread
    contrast = float(median_of(m.contrast[valid]))
    misfit = MISFIT * max(contrast - ordinary, 0.0)
    limit = max(ORDINARY_RESIDUAL * ordinary, ordinary + 6.0 * spread, ordinary + misfit)
    fits = valid & (m.residual <= limit)
    verdict[valid & ~fits] = PoiStatus.LOW_ZNCC
    safe = SAFE_SIGMA * NOISE_SIGMA_PX / grid.subset_px
    excusable = valid & ~fits & (m.residual <= ordinary + CONFIRMED_MISFIT * max(contrast - ordinary, 0.0))
    sigma = float(median_of(sigma_px[fits]))
    sound = fits & (sigma_px <= max(SPREADING_SIGMA * sigma, safe))
    torn = _torn(m, fits | excusable, sound, grid)
    if torn.any():
        verdict[torn & fits] = PoiStatus.INCONSISTENT
        fits &= ~torn
        excusable &= ~torn
        if not fits.any():
            return verdict
        sigma = float(median_of(sigma_px[fits]))
    signal = m.contrast - ordinary
    usual = float(median_of(signal[fits]))
    plain = fits & (sigma_px <= max(ORDINARY_SIGMA * sigma, safe)) & (signal <= (1.0 + EXCESS_PX / grid.subset_px) * usual)
    plain &= m.residual <= max(RESIDUAL_NEEDING_SUPPORT * ordinary, ordinary + 3.0 * spread, ordinary + PLAIN_MISFIT * misfit)
    trusted = plain & ~_alone(m, plain, grid)
    weak = fits & (sigma_px > max(WEAK_SIGMA * sigma, safe))
    verdict[weak] = PoiStatus.LOW_CONTRAST
    suspect = fits & ~trusted & ~weak
    surrounded = _around(valid & ~fits & ~excusable) >= REJECTED_NEIGHBOURS
    excusable &= sigma_px <= max(WEAK_SIGMA * sigma, safe)
    if suspect.any() or excusable.any():
        believed = _confirmed(
            m, trusted, suspect & ~surrounded, excusable, fits & (sigma_px <= max(SPREADING_SIGMA * sigma, safe)), grid, curved
        )
        verdict[suspect & ~believed] = PoiStatus.INCONSISTENT
        verdict[excusable & believed] = PoiStatus.CONVERGED
    beyond = (verdict != PoiStatus.CONVERGED) | EDGES[m.status]
    if not beyond.any():
        return verdict
    around = _around(beyond)
    if ordinary > HIGH_NOISE_VARIANCE * (contrast - ordinary):
        edge = around >= EDGE_AROUND
    else:
        edge = (around >= REJECTED_NEIGHBOURS) & (sigma_px > WEAK_SIGMA * sigma)  # weak, but called safe
    verdict[valid & ~beyond & edge] = PoiStatus.INCONSISTENT
    return verdict


def _torn(m: PointMeasurements, among: NDArray[np.bool_], sound: NDArray[np.bool_], grid: Grid) -> NDArray[np.bool_]:
    """Where the displacement drops across a subset as it does on neither side half a subset away, or a whole one.

    Args:
        m: the map.
        among: points to tell it of.
        sound: points to compare with.
        grid: the points.
    """
    span = ptp_columns(m.gradient.reshape(-1, 4)) * (grid.subset_px / 1.5)
    if max(np.hypot(span[0], span[2]), np.hypot(span[1], span[3])) <= JUMP_PX:
        return np.zeros(sound.shape, dtype=bool)  # no two slopes differ enough anywhere
    jump = np.zeros(sound.shape)
    moved = np.stack([m.u_px, m.v_px], axis=-1)
    for distance in (0.5, 1.0):
        steps = max(1, round(distance * grid.subset_px / grid.step_px))
        for axis in range(2):
            slope = m.gradient[..., axis::2]  # du/dx and dv/dx drop along x
            there = {way: _shifted(sound, way * steps, axis) for way in (-1, 1)}
            slopes = {way: _shifted(slope, way * steps, axis) for way in (-1, 1)}
            least = np.full(sound.shape, np.inf)
            for way in (-1, 1):
                excess = np.linalg.norm(slope - slopes[way], axis=-1) * (grid.subset_px / 1.5)
                least = np.where(there[way], np.minimum(least, excess), least)
            # A wave as short as a subset has such slopes too, but no step.
            ramp = (slopes[-1] + slopes[1]) * (steps * grid.step_px)
            step = np.linalg.norm(_shifted(moved, steps, axis) - _shifted(moved, -steps, axis) - ramp, axis=-1)
            least = np.where(there[-1] & there[1], np.minimum(least, step), least)
            jump = np.maximum(jump, np.where(np.isfinite(least), least, 0.0))
    torn = among & (jump > np.maximum(JUMP_PX, SIGMAS * 4.0 * m.sigma_px))
    return torn | (among & (_around(torn) >= DISCONTINUITY_NEIGHBOURS))


def _around(marked: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """How many of a point and its eight neighbours are marked."""
    if not marked.any():
        return np.zeros(marked.shape, dtype=np.uint8)
    return np.asarray(ndimage.convolve(marked.astype(np.uint8), np.ones((3, 3), np.uint8), mode="constant"), dtype=np.uint8)


def _shifted(values: NDArray, steps: int, axis: int) -> NDArray:
    """Values `steps` points further along x (axis 0) or y (axis 1), zero beyond the map."""
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


def _alone(m: PointMeasurements, plain: NDArray[np.bool_], grid: Grid) -> NDArray[np.bool_]:
    """Plain points in groups of fewer than MIN_COMPANY that agree with one another."""
    size = cluster_sizes(m.u_px, m.v_px, m.gradient, m.sigma_px, plain, 0.5 * grid.step_px, LINKS_PX)
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
    """Suspects that agree with a plane through the trusted points around; those confirmed are trusted in turn.

    Excusable ones, of a larger residual, must have more trusted points around, and are not trusted in turn. What raises a
    residual at one place, such as a grain that one frame alone saturates, does so in all the subsets that hold it: the middle
    ones of these have trusted points only beyond, and are looked at twice as far.
    """
    trusted = trusted.copy()
    believed = np.zeros(suspect.shape, dtype=bool)
    reach = int(np.clip(round(grid.subset_px / 2 / grid.step_px), 1, MAX_REACH))
    determined = np.array([grid.nx >= MIN_LINES, grid.ny >= MIN_LINES] * 2)  # slopes that the points can tell
    small = max(REFERENCE_SUBSET_PX / grid.subset_px, 1.0)
    agrees_px, bends_px = AGREES_PX * small * (QUADRATIC_NOISE_RATIO if curved else 1.0), BENDS_PX * small
    tolerance = agrees_px + np.where(spreading, m.sigma_px, 0.5 * np.median(m.sigma_px[trusted]) if trusted.any() else 0.0)
    u_px, v_px = (np.ascontiguousarray(value, dtype=np.float64) for value in (m.u_px, m.v_px))

    def agreeing(near: NDArray[np.bool_], reach: int, part: NDArray[np.float64] | float) -> NDArray[np.bool_]:
        """Those near that agree with the trusted within reach, where these are a large enough part of the points there."""
        around = min(2 * reach + 1, grid.ny) * min(2 * reach + 1, grid.nx)
        u, v, slope, support = fit_local_planes(u_px, v_px, trusted, near, reach)
        distance = np.hypot(u_px[near] - u, v_px[near] - v)
        bent = np.linalg.norm((m.gradient[near] - slope / grid.step_px) * determined, axis=-1) * (grid.subset_px // 2)
        agree = np.zeros(suspect.shape, dtype=bool)
        agree[near] = (support >= np.maximum(3.0, part * around)) & (distance <= tolerance[near]) & (bent <= bends_px)
        return agree

    near = pending = suspect | excusable
    for _ in range(MAX_ROUNDS):
        fresh = agreeing(near, reach, np.where(excusable[near], MIN_TRUSTED_FRACTION, MIN_SUPPORT))
        believed |= fresh
        added = fresh & spreading & ~trusted
        if not added.any():
            break
        trusted |= added
        # to the others nothing has changed
        reached = np.asarray(ndimage.maximum_filter(added, 2 * reach + 1, mode="constant"), dtype=bool)
        near = pending & ~believed & reached
    rejected = excusable & ~believed
    return believed | agreeing(rejected, 2 * reach, MIN_TRUSTED_FRACTION_FAR) if rejected.any() else believed
