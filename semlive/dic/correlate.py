"""Disparity from a prepared reference to a current frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.grid import Grid, grid_for
from semlive.data.settings import DicSettings
from semlive.dic.initial_guess.fields import nearest_block_field, residual_affine_field, smooth_field
from semlive.dic.initial_guess.search import match
from semlive.dic.method_choice import choose_map, measure_globally
from semlive.dic.neighbour_scatter import widened
from semlive.dic.outlier_rejection import PointMeasurements, rejection_status
from semlive.dic.reference import Reference, prepare, texture_length
from semlive.dic.reseed import MIN_DISCREPANCY_PX, neighbour_seeds, seed_distance
from semlive.dic.second_estimate import SecondEstimates, confirm, second_estimates
from semlive.dic.uncertainty import noise_variance
from semlive.errors import BadInput
from semlive.kernels import arrays, images
from semlive.kernels.local_planes import fit_local_planes
from semlive.kernels.shot_noise import gradient_grey_sums
from semlive.kernels.splines import spline_sampling
from semlive.kernels.splines.spline import CUBIC, QUINTIC
from semlive.kernels.subset_matching import interface
from semlive.kernels.subset_matching.fourth_order_matrix import QUARTIC
from semlive.kernels.subset_matching.icgn import SEED_FROM_NEIGHBOUR, SEEDED, SKIP
from semlive.kernels.threads import run_pair_in_parallel

FINAL = np.zeros(256, dtype=np.bool_)  # by status: no further attempt
FINAL[[PoiStatus.CONVERGED, PoiStatus.LOW_CONTRAST, PoiStatus.AMBIGUOUS, PoiStatus.MASKED]] = True
ORDER = {"cubic": CUBIC, "quintic": QUINTIC}  # order of the spline
MAX_PASSES = 12  # retries from neighbours; each adds one ring of POI
MAX_TRAVEL_PX = 8.0  # largest distance of an IC-GN solution from its initial guess, one or two speckles


def correlate(
    reference: Reference,
    image: NDArray[np.uint8] | NDArray[np.uint16],
    settings: DicSettings,
    *,
    reference_frame: int,
    current_frame: int,
) -> DisparityMap:
    """Measure the disparity at every POI of the reference: ``x_current = x_reference + u``.

    IC-GN minimises ZNSSD with the shape function of the reference. The result does not depend on the number of threads. With the
    method ``auto``, the global method replaces the map if subsets measure too few points (`method_choice`).

    Args:
        reference: from `prepare`.
        image: (height, width) current frame, uint8 or uint16.
        settings: tolerance, iterations, smallest ZNCC, method.
        reference_frame: number of the reference frame.
        current_frame: number of the current frame.

    Raises:
        BadInput: the frames differ in size.
        ValueError: the image has another form.
    """
    if image.shape != reference.shape:
        (h0, w0), (h1, w1) = reference.shape, image.shape
        raise BadInput(
            f"frame {current_frame} is {w1} x {h1} px but its reference, frame {reference_frame}, is {w0} x {h0} px: "
            "export all frames with the same size and databar"
        )
    current = images.to_float32_grey(image)

    frames = {"reference_frame": reference_frame, "current_frame": current_frame}
    by_global_method = partial(measure_globally, reference, current, settings, **frames)
    if settings.method == "global":
        return by_global_method()

    def guessed() -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        matches = match(reference.coarse, current)
        return matches, smooth_field(matches, reference.grid) if len(matches) else None

    (matches, guess), interpolator = run_pair_in_parallel(
        guessed, lambda: images.interpolator(current, ORDER[settings.interpolation]), worth=current.size >= arrays.PIXEL_CHUNK
    )
    solutions = solve(reference, interpolator, matches, settings, guess, lambda: residual_affine_field(matches, reference.grid))
    measurements = point_measurements(reference, solutions, settings)
    to_map = partial(to_disparity_map, measurements, reference.grid, settings, **frames)
    disparity = to_map()
    second = partial(second_estimates, reference, current, solutions, settings)
    return choose_map(
        disparity,
        measurements,
        reference.noise_grey,
        settings,
        lambda: to_map(second=second()),
        by_global_method,
        lambda: widened(disparity, second(), settings),
    )


def point_measurements(reference: Reference, solutions: interface.Solutions, settings: DicSettings) -> PointMeasurements:
    """Point measurements from the solutions, with their uncertainties; zero for points without convergence."""
    valid = solutions.status == PoiStatus.CONVERGED
    p = solutions.parameters
    sums = reference.sums
    variance = noise_variance(
        p,
        solutions.zncc,
        sums.norm,
        reference.grid.subset_px,
        interpolation=settings.interpolation,
        fitted=sums.parameters,
        pixels=sums.pixels,
    )
    variance_u, variance_v, covariance, residual = (
        2.0 * variance * sums.variance_u,
        2.0 * variance * sums.variance_v,
        2.0 * variance * sums.covariance,
        variance,
    )
    if (factors := reference.factors) is not None:
        variance_u, variance_v, covariance = variance_u * factors.u, variance_v * factors.v, covariance * np.sqrt(factors.u * factors.v)
        residual = variance / factors.level  # comparable between bright and dark subsets
    return PointMeasurements(
        u_px=np.where(valid, p[..., 0], 0.0),
        v_px=np.where(valid, p[..., 3], 0.0),
        gradient=p[..., [1, 2, 4, 5]].astype(np.float32, order="C"),
        sigma_u_px=np.sqrt(variance_u),
        sigma_v_px=np.sqrt(variance_v),
        covariance_px2=covariance,
        zncc=solutions.zncc,
        residual=residual.astype(np.float32),
        contrast=(sums.norm**2 / np.maximum(sums.pixels, 1.0)).astype(np.float32),
        status=solutions.status,
        iterations=solutions.iterations,
        length=texture_length(reference).astype(np.float32),
    )


def to_disparity_map(
    measurements: PointMeasurements,
    grid: Grid,
    settings: DicSettings,
    *,
    reference_frame: int,
    current_frame: int,
    second: SecondEstimates | None = None,
) -> DisparityMap:
    """Disparity map of the accepted point measurements.

    A quartic subset resolves what a quadratic one of 4/7 of its edge does, with similar noise; its points are tested as such ones.

    Args:
        measurements: measurements of the complete map.
        grid: grid of the points.
        settings: of the correlation.
        reference_frame: number of the reference frame.
        current_frame: number of the current frame.
        second: second estimates of a map with many doubtful points.
    """
    resolved = dataclasses.replace(grid, subset_px=grid.subset_px * 4 // 7 | 1) if settings.shape_function == "quartic" else grid
    verdict = rejection_status(measurements, resolved, curved=settings.shape_function != "affine")
    if second is not None:
        measurements, verdict = confirm(measurements, verdict, second, resolved)
    valid = measurements.valid & (verdict == PoiStatus.CONVERGED)

    def where_valid(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(valid, values, 0.0)

    return DisparityMap(
        reference=reference_frame,
        current=current_frame,
        grid=grid,
        u_px=where_valid(measurements.u_px),
        v_px=where_valid(measurements.v_px),
        sigma_u_px=where_valid(measurements.sigma_u_px),
        sigma_v_px=where_valid(measurements.sigma_v_px),
        zncc=where_valid(measurements.zncc),
        status=np.where(verdict == PoiStatus.CONVERGED, measurements.status, verdict),
        covariance_px2=where_valid(measurements.covariance_px2),
        iterations=measurements.iterations,
    )


def solve(
    reference: Reference,
    interpolator: NDArray[np.float32],
    matches: NDArray[np.float64],
    settings: DicSettings,
    guess: NDArray[np.float64] | None = None,
    second: Callable[[], NDArray[np.float64] | None] = lambda: None,
) -> interface.Solutions:
    """Affine parameters at every POI.

    The first pass follows rows from a smooth field of initial guesses. Failed points are retried from the nearest block (for a
    discontinuity within the frame), then from the motion of blocks that the smooth field does not explain, then from converged
    neighbours, ring by ring. A shape function of fourth order starts from the solutions of second order.

    Args:
        reference: from `prepare`.
        interpolator: spline coefficients of the current frame.
        matches: (n, 4) matched blocks.
        settings: tolerance, iterations, smallest ZNCC.
        guess: (ny, nx, 6) initial guesses; None: `smooth_field` of the matches.
        second: function that returns alternative initial guesses (`residual_affine_field`) or None; called only if needed.
    """
    solutions = first_attempts(reference, interpolator, matches, settings, guess, second)
    retry_from_neighbours(reference, interpolator, solutions, settings)
    refine_fourth_order(reference, interpolator, solutions, settings)
    return solutions


def first_attempts(
    reference: Reference,
    interpolator: NDArray[np.float32],
    matches: NDArray[np.float64],
    settings: DicSettings,
    guess: NDArray[np.float64] | None = None,
    second: Callable[[], NDArray[np.float64] | None] = lambda: None,
) -> interface.Solutions:
    """The part of `solve` in which rows of points do not depend on each other; arguments as for it."""
    grid, solutions = reference.grid, _unsolved(reference)
    status = solutions.status
    if not len(matches):
        return solutions
    guess = smooth_field(matches, grid) if guess is None else guess
    _attempt(reference, interpolator, settings, solutions, status == PoiStatus.NO_SEED, SEED_FROM_NEIGHBOUR, guess)
    if (failed := ~FINAL[status]).any():
        _attempt(reference, interpolator, settings, solutions, failed, SEED_FROM_NEIGHBOUR, nearest_block_field(matches, grid))
    if (failed := ~FINAL[status]).any() and (alternative := second()) is not None:
        different = failed & (seed_distance(alternative, guess) > MIN_DISCREPANCY_PX)
        _attempt(reference, interpolator, settings, solutions, different, SEED_FROM_NEIGHBOUR, alternative)
    return solutions


def retry_from_neighbours(
    reference: Reference, interpolator: NDArray[np.float32], solutions: interface.Solutions, settings: DicSettings
) -> None:
    """Retry failed points from their converged neighbours, at most MAX_PASSES rings of them; writes into the solutions."""
    status = solutions.status
    fresh = status == PoiStatus.CONVERGED
    for _ in range(MAX_PASSES):
        if not (failed := ~FINAL[status]).any() or not fresh.any():
            break
        first, reachable, second_guess, has_second = neighbour_seeds(solutions, fresh, reference.grid.step_px)
        if not (failed & reachable).any():
            break
        _attempt(reference, interpolator, settings, solutions, failed & reachable, SEEDED, first)
        again = failed & has_second & (status != PoiStatus.CONVERGED)
        _attempt(reference, interpolator, settings, solutions, again, SEEDED, second_guess)
        fresh = failed & (status == PoiStatus.CONVERGED)


def _attempt(
    reference: Reference,
    interpolator: NDArray[np.float32],
    settings: DicSettings,
    solutions: interface.Solutions,
    where: NDArray[np.bool_],
    mode: int,
    seeds: NDArray[np.float64],
) -> None:
    interface.correlate(
        reference.sums,
        interpolator,
        np.where(where, mode, SKIP).astype(np.uint8),
        seeds,
        solutions,
        max_iterations=settings.max_iterations,
        tolerance_px=settings.tolerance_px,
        min_zncc=settings.min_zncc,
        max_travel_px=MAX_TRAVEL_PX,
        order=ORDER[settings.interpolation],
    )


def refine_fourth_order(
    reference: Reference, interpolator: NDArray[np.float32], solutions: interface.Solutions, settings: DicSettings
) -> None:
    """Continue with the shape function of fourth order if the reference is prepared for it; writes into the solutions."""
    if solutions.curvatures is not None:
        interface.refine(
            reference.sums,
            interpolator,
            solutions,
            max_iterations=settings.max_iterations,
            tolerance_px=settings.tolerance_px,
            min_zncc=settings.min_zncc,
            order=ORDER[settings.interpolation],
        )


def _unsolved(reference: Reference) -> interface.Solutions:
    shape = reference.grid.shape
    status = np.where(reference.status == PoiStatus.CONVERGED, PoiStatus.NO_SEED, reference.status).astype(np.uint8)
    status[(status == PoiStatus.NO_SEED) & reference.coarse.ambiguous] = PoiStatus.AMBIGUOUS
    iterations = np.zeros(shape, dtype=np.int32)
    curvatures = np.zeros((*shape, 6)) if reference.sums.parameters == QUARTIC else None
    return interface.Solutions(np.zeros((*shape, 6)), np.zeros(shape), status, iterations, curvatures)


def warm_up(settings: DicSettings) -> None:
    """Compile every kernel, or load it from the cache, by correlating a small synthetic pair.

    Args:
        settings: settings of the correlation; only the sizes are replaced.
    """
    speckle = cv2.GaussianBlur(np.random.default_rng(1).standard_normal((96, 96)), (0, 0), 2.0)  # must not be periodic
    image = np.clip(128.0 + 280.0 * speckle, 0, 255).astype(np.uint8)
    small = dataclasses.replace(settings, subset_px=21, step_px=20, roi_px=None)
    reference = prepare(image, grid_for(small, 96, 96), small)
    current = np.roll(image, 1, axis=1)
    correlate(reference, current, small, reference_frame=0, current_frame=1)
    images.to_float32_grey(image.astype(np.uint16))
    spline_sampling.sample(images.coefficients(image.astype(np.float32)), *np.zeros((2, 1, 1), dtype=np.float32))  # by the global method
    no_points = np.zeros((1, 1), dtype=np.bool_)
    gradient_grey_sums(reference.sums)  # needed where the noise grows with the grey level
    fit_local_planes(np.zeros((1, 1)), np.zeros((1, 1)), no_points, no_points, 1)  # not needed by a pair without outliers
