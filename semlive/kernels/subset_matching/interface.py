"""Interface of the compiled kernels for subsets: checks arrays, lays them out, and distributes rows over threads."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from semlive.kernels.arrays import ROW_CHUNK, checked, lines_at_once
from semlive.kernels.interpolate import LANES
from semlive.kernels.malloc import keep_freed_memory
from semlive.kernels.splines import spline
from semlive.kernels.subset_matching import fourth_order, fourth_order_matrix, icgn, subsets, warp
from semlive.kernels.threads import parallel_chunks

keep_freed_memory()


@dataclass(frozen=True, slots=True, eq=False)
class SubsetSums:
    """Reference image and the sums of each of its subsets for every correlation (see `subsets.sum_rows`).

    All arrays are read-only: the kernels would be compiled a second time for arrays that are not, for which a live run had to wait.

    Attributes:
        width_px: image width; the arrays below are padded along rows.
        planes: (height, 3, width + pad) float32: grey levels and scaled derivatives along x and y of each row, adjacent because they are
            used together.
        valid: (height, width + pad), 1 where a pixel is valid, else 0; without rows if every pixel is valid.
        x0_px: column of the first POI.
        y0_px: row of the first POI.
        step_px: distance of neighbouring POI.
        half_px: half the subset, without its centre.
        parameters: number of parameters of the shape function: 6, 12 or 30. The sums below have at most n = 12; for 30 parameters only the
            variances and the covariance are those of fourth order, whose matrices `refine` computes where it needs them.
        pixels: (ny, nx) valid pixels of each subset.
        mean: (ny, nx) mean of each subset.
        norm: (ny, nx) root of the centred sum of squares of each subset.
        gradient_sum: (ny, nx, n) sums of the derivatives with respect to n = 6 or 12 parameters.
        gradient_image_sum: (ny, nx, n) sums of their products with the centred image.
        lower: (ny, nx, n, n) Cholesky factors of the Gauss-Newton matrices (lower triangles).
        variance_u: (ny, nx) variance of u in px^2 for noise of one grey level; zero where singular.
        variance_v: (ny, nx) variance of v in px^2 for noise of one grey level.
        covariance: (ny, nx) covariance of u and v in px^2 for noise of one grey level.
        sssig: (ny, nx) smaller eigenvalue of the 2x2 sum of squared gradients, (grey/px)^2.
    """

    width_px: int
    planes: NDArray[np.float32]
    valid: NDArray[np.float32]
    x0_px: int
    y0_px: int
    step_px: int
    half_px: int
    parameters: int
    pixels: NDArray[np.float64]
    mean: NDArray[np.float64]
    norm: NDArray[np.float64]
    gradient_sum: NDArray[np.float64]
    gradient_image_sum: NDArray[np.float64]
    lower: NDArray[np.float64]
    variance_u: NDArray[np.float64]
    variance_v: NDArray[np.float64]
    covariance: NDArray[np.float64]
    sssig: NDArray[np.float64]

    @property
    def gradient_x(self) -> NDArray[np.float32]:
        """(height, width) scaled derivative along x."""
        return self.planes[:, 1, : self.width_px]

    @property
    def gradient_y(self) -> NDArray[np.float32]:
        """(height, width) scaled derivative along y."""
        return self.planes[:, 2, : self.width_px]


def _pitch(width: int) -> int:
    """Floats from one row to the next, so that complete vectors can be read at the end of a row."""
    return (width + 2 * LANES - 1) // LANES * LANES


def subset_sums(
    image: NDArray[np.float32],
    gradient_x: NDArray[np.float32] | None = None,
    gradient_y: NDArray[np.float32] | None = None,
    *,
    x0_px: int,
    y0_px: int,
    step_px: int,
    shape: tuple[int, int],
    half_px: int,
    parameters: int = warp.AFFINE,
    gains: tuple[float, float] = (1.0, 1.0),
    valid: NDArray[np.float32] | None = None,
) -> SubsetSums:
    """Prepare every subset of a grid of `shape` = (ny, nx) POI.

    Args:
        image: (height, width) grey levels.
        gradient_x: same shape, derivative along x; None: Sobel derivatives.
        gradient_y: same shape, derivative along y, if `gradient_x` is given.
        x0_px: column of the first POI.
        y0_px: row of the first POI.
        step_px: distance of neighbouring POI.
        shape: (ny, nx).
        half_px: half the subset, without its centre.
        parameters: number of parameters of the shape function, 6 (affine), 12 (second order) or 30 (fourth order).
        gains: factors of the derivatives along x and y.
        valid: same shape as the image, 1 where a pixel is valid, else 0; None: all are valid.

    Raises:
        ValueError: arrays of wrong dtype, shape or layout, or a subset outside the image.
    """
    checked(image, "image", np.float32, (None, None))
    height, width = image.shape
    gradient_images = [] if gradient_x is None else [checked(gradient_x, "gradient_x", np.float32, (height, width))]
    if gradient_x is not None:
        gradient_images.append(checked(gradient_y, "gradient_y", np.float32, (height, width)))
    ny, nx = shape
    right = x0_px + (nx - 1) * step_px + half_px
    bottom = y0_px + (ny - 1) * step_px + half_px
    if min(ny, nx, step_px) < 1 or min(x0_px, y0_px) < half_px or right > width - 1 or bottom > height - 1:
        raise ValueError(
            f"subsets from ({x0_px - half_px}, {y0_px - half_px}) to ({right}, {bottom}) are outside the {width} x {height} px image"
        )
    if parameters not in (warp.AFFINE, warp.QUADRATIC, fourth_order_matrix.QUARTIC):
        raise ValueError(f"parameters must be {warp.AFFINE}, {warp.QUADRATIC} or {fourth_order_matrix.QUARTIC}, not {parameters}")
    count = min(parameters, warp.QUADRATIC)
    if valid is not None:
        checked(valid, "valid", np.float32, (height, width))
    pitch = _pitch(width)
    planes = np.empty((height, 3, pitch), dtype=np.float32)
    weights = np.zeros((0 if valid is None else height, pitch), dtype=np.float32)

    def lines(first: int, last: int) -> None:
        if valid is not None:
            weights[first:last, :width] = valid[first:last]
        subsets.fill_planes(image, weights, planes, first, last, np.float32(gains[0]), np.float32(gains[1]))
        for k, gradient in enumerate(gradient_images):
            planes[first:last, 1 + k, :width] = gradient[first:last] * np.float32(gains[k])
            if valid is not None:
                planes[first:last, 1 + k, :width] *= valid[first:last]

    parallel_chunks(lines, height, lines_at_once(width))
    for written in (planes, weights):
        written.setflags(write=False)
    result = SubsetSums(
        width_px=width,
        planes=planes,
        valid=weights,
        x0_px=x0_px,
        y0_px=y0_px,
        step_px=step_px,
        half_px=half_px,
        parameters=parameters,
        pixels=np.zeros(shape),
        mean=np.zeros(shape),
        norm=np.zeros(shape),
        gradient_sum=np.zeros((*shape, count)),
        gradient_image_sum=np.zeros((*shape, count)),
        lower=np.zeros((*shape, count, count)),
        variance_u=np.zeros(shape),
        variance_v=np.zeros(shape),
        covariance=np.zeros(shape),
        sssig=np.zeros(shape),
    )
    r = result
    flat = planes.ravel(), weights.ravel()

    def rows(first: int, last: int) -> None:
        subsets.sum_rows(
            *flat, pitch, first, last, x0_px, y0_px, step_px, half_px, r.pixels, r.mean, r.norm,
            r.gradient_sum, r.gradient_image_sum, r.lower, r.variance_u, r.variance_v, r.covariance,
            r.sssig,
        )  # fmt: skip
        if parameters == fourth_order_matrix.QUARTIC:
            fourth_order_matrix.variance_rows(
                flat[0], pitch, first, last, x0_px, y0_px, step_px, half_px, r.variance_u, r.variance_v, r.covariance
            )  # fmt: skip

    parallel_chunks(rows, ny, ROW_CHUNK)
    for field in fields(result):
        value = getattr(result, field.name)
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class Solutions:
    """State of every POI of a correlation; `correlate` writes into these arrays.

    Attributes:
        parameters: (ny, nx, 6) affine parameters (u, du/dx, du/dy, v, dv/dx, dv/dy).
        zncc: (ny, nx) zero-normalised cross-correlation before the last update.
        status: (ny, nx) uint8, PoiStatus.
        iterations: (ny, nx) int32 iterations spent on the last attempt.
        curvatures: (ny, nx, 6) second derivatives (uxx, uxy, uyy, vxx, vxy, vyy); None if not needed.
    """

    parameters: NDArray[np.float64]
    zncc: NDArray[np.float64]
    status: NDArray[np.uint8]
    iterations: NDArray[np.int32]
    curvatures: NDArray[np.float64] | None = None


def correlate(
    reference: SubsetSums,
    current: NDArray[np.float32],
    todo: NDArray[np.uint8],
    seeds: NDArray[np.float64],
    solutions: Solutions,
    *,
    max_iterations: int,
    tolerance_px: float,
    min_zncc: float,
    max_travel_px: float,
    order: int = spline.CUBIC,
) -> None:
    """Run IC-GN on the POI marked in `todo` (icgn.SKIP, SEEDED or SEED_FROM_NEIGHBOUR), and write into `solutions`.

    Args:
        reference: from `subset_sums`.
        current: `interpolator` of the current image.
        todo: (ny, nx) mode of each POI.
        seeds: (ny, nx, 6) initial guesses.
        solutions: arrays to write into; POI marked SKIP are not changed.
        max_iterations: maximum number of iterations of a POI.
        tolerance_px: largest expected motion of a subset corner in the next update.
        min_zncc: smallest ZNCC of a solution.
        max_travel_px: largest distance from the initial guess.
        order: order of the spline of `current`.

    Raises:
        ValueError: arrays of wrong dtype, shape or layout.
    """
    r = reference
    ny, nx = r.mean.shape
    border, six = icgn.border_of(order), warp.AFFINE
    checked(current, "current", np.float32, (r.planes.shape[0] + 2 * border, r.width_px + 2 * border + LANES))
    checked(todo, "todo", np.uint8, (ny, nx))
    checked(seeds, "seeds", np.float64, (ny, nx, six))
    s = solutions
    checked(s.parameters, "parameters", np.float64, (ny, nx, six))
    checked(s.zncc, "zncc", np.float64, (ny, nx))
    checked(s.status, "status", np.uint8, (ny, nx))
    checked(s.iterations, "iterations", np.int32, (ny, nx))
    curvatures = np.zeros((ny, nx, six)) if s.curvatures is None else s.curvatures
    checked(curvatures, "curvatures", np.float64, (ny, nx, six))
    size = 2 * r.half_px + 1
    row_weights = np.concatenate([np.ones(size, dtype=np.float32), np.zeros(LANES, dtype=np.float32)])
    ramp = np.arange(size + LANES, dtype=np.float32)
    images = (current.ravel(), current.shape[1], order, r.planes.ravel(), r.valid.ravel(), r.planes.shape[2])

    def rows(first: int, last: int) -> None:
        icgn.correlate_rows(
            first, last, *images, row_weights, ramp, r.width_px, r.y0_px, r.x0_px, r.step_px, r.half_px, r.pixels, r.mean, r.norm,
            r.gradient_sum, r.gradient_image_sum, r.lower, todo, seeds, max_iterations, tolerance_px, min_zncc, max_travel_px,
            s.parameters, curvatures, s.zncc, s.status, s.iterations,
        )  # fmt: skip

    parallel_chunks(rows, ny, 1)


def refine(
    reference: SubsetSums,
    current: NDArray[np.float32],
    solutions: Solutions,
    *,
    max_iterations: int,
    tolerance_px: float,
    min_zncc: float,
    order: int = spline.CUBIC,
) -> None:
    """Refine the converged second-order `solutions` with the shape function of fourth order; points that fail get another status.

    Args:
        reference: from `subset_sums` for 30 parameters.
        current: `interpolator` of the current image.
        solutions: from `correlate` with this reference; must have `curvatures`.
        max_iterations: maximum number of further iterations of a POI.
        tolerance_px: as for `correlate`.
        min_zncc: smallest ZNCC of a solution.
        order: order of the spline of `current`.

    Raises:
        ValueError: arrays of wrong dtype, shape or layout.
    """
    r, s = reference, solutions
    ny, nx = r.mean.shape
    border = icgn.border_of(order)
    checked(current, "current", np.float32, (r.planes.shape[0] + 2 * border, r.width_px + 2 * border + LANES))
    checked(s.parameters, "parameters", np.float64, (ny, nx, warp.AFFINE))
    checked(s.curvatures, "curvatures", np.float64, (ny, nx, warp.AFFINE))
    checked(s.zncc, "zncc", np.float64, (ny, nx))
    checked(s.status, "status", np.uint8, (ny, nx))
    checked(s.iterations, "iterations", np.int32, (ny, nx))
    images = (current.ravel(), current.shape[1], order, r.planes.ravel(), r.valid.ravel(), r.planes.shape[2], r.width_px)

    def rows(first: int, last: int) -> None:
        fourth_order.refine_rows(
            first, last, *images, r.y0_px, r.x0_px, r.step_px, r.half_px, r.pixels, r.mean, r.norm, max_iterations, tolerance_px, min_zncc,
            s.parameters, s.curvatures, s.zncc, s.status, s.iterations,
        )  # fmt: skip

    parallel_chunks(rows, ny, 1)
