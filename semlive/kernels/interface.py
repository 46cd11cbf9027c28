"""The one door to the compiled kernels: checks dtype, shape and contiguity, lays arrays out, spreads rows over threads."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray

from semlive.kernels import gradient_statistics, icgn, spline, subsets, warp
from semlive.kernels.interpolate import LANES
from semlive.kernels.malloc import keep_freed_memory
from semlive.kernels.order_statistics import middle_bits
from semlive.kernels.threads import parallel_chunks

MIN_EDGE_PX = 4
ROW_CHUNK = 4  # of POI that a thread takes; a constant
PIXEL_CHUNK = 98304  # of an image; to begin a thread for fewer costs more than it saves
MIN_COLUMNS = 64  # filtered together, a row of them at a time

keep_freed_memory()


def _lines_at_once(width: int) -> int:
    """Lines of an image of this width that a thread takes."""
    return max(1, PIXEL_CHUNK // width)


def checked(array: object, name: str, dtype: DTypeLike, shape: tuple[int | None, ...]) -> NDArray:
    """The array itself if it is C-contiguous and of this dtype and shape (None: any length).

    Raises:
        ValueError: it is not.
    """
    if not isinstance(array, np.ndarray):
        raise ValueError(f"{name} must be an array, not {type(array).__name__}")
    if array.dtype != np.dtype(dtype):
        raise ValueError(f"{name} must be {np.dtype(dtype)}, not {array.dtype}")
    if array.ndim != len(shape) or any(want is not None and have != want for have, want in zip(array.shape, shape, strict=True)):
        raise ValueError(f"{name} must have shape {tuple('any' if n is None else n for n in shape)}, not {array.shape}")
    if not array.flags.c_contiguous:
        raise ValueError(f"{name} must be C-contiguous")
    return array


def to_float32_grey(image: object, mask: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
    """An 8 or 16 bit image as float32 grey levels, its mean subtracted (float32 sums of squares lose nothing then).

    Args:
        image: (height, width) uint8 or uint16.
        mask: (height, width) True where the image may be used; the mean is that part's, the rest is made zero.

    Raises:
        ValueError: not a two-dimensional uint8 or uint16 array of at least 4 x 4 px.
    """
    if not isinstance(image, np.ndarray) or image.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"image must be a uint8 or uint16 array, not {getattr(image, 'dtype', type(image).__name__)}")
    if image.ndim != 2 or min(image.shape) < MIN_EDGE_PX:
        raise ValueError(f"image must be (height, width) of at least {MIN_EDGE_PX} px each, not {image.shape}")
    if mask is None and image.flags.c_contiguous and image.flags.aligned:
        out = np.empty(image.shape, dtype=np.float32)
        levels = image.reshape(-1)
        levels.setflags(write=False)  # of this view: else all would be compiled again for frames that are read-only
        gradient_statistics.subtract_mean(levels, out.reshape(-1))
        return out
    if mask is None:
        return np.subtract(image, mean_of(image), dtype=np.float32)
    mean = np.float32(image[mask].mean() if mask.any() else 0.0)
    return np.where(mask, np.subtract(image, mean, dtype=np.float32), np.float32(0.0))


def mean_of(image: NDArray[np.uint8] | NDArray[np.uint16]) -> np.float32:
    """Mean grey level. OpenCV's sum of whole numbers is exact too, and takes 0.01 ms of 905,000 px where NumPy's mean takes 0.34."""
    return np.float32(cv2.sumElems(image)[0] / image.size)


def _checked_image(image: NDArray[np.float32]) -> None:
    checked(image, "image", np.float32, (None, None))
    if min(image.shape) < MIN_EDGE_PX:
        raise ValueError(f"image must be at least {MIN_EDGE_PX} px each way, not {image.shape}")


def coefficients(image: NDArray[np.float32], order: int = spline.CUBIC) -> NDArray[np.float32]:
    """B-spline coefficients of an image, (height, width), boundary mirrored about the outer samples.

    Args:
        image: float32 grey levels.
        order: of the spline, 3 or 5.

    Raises:
        ValueError: not a C-contiguous float32 image of at least 4 x 4 px.
    """
    _checked_image(image)
    c = image.copy()
    _filter(c, order, 0, c.shape[1])
    return c


def _filter(c: NDArray[np.float32], order: int, left: int, right: int) -> None:
    """Samples in columns left..right-1 to coefficients, in place."""
    for pole, gain in zip(spline.POLES[order], spline.GAINS[order], strict=True):
        parallel_chunks(
            lambda first, last: spline.filter_rows(c, first, last, left, right, pole, gain),  # noqa: B023
            c.shape[0],
            _lines_at_once(c.shape[1]),
        )
        columns = max(MIN_COLUMNS, _lines_at_once(c.shape[0]))
        parallel_chunks(lambda first, last: spline.filter_columns(c, left + first, left + last, pole, gain), right - left, columns)  # noqa: B023


def interpolator(image: NDArray[np.float32], order: int = spline.CUBIC) -> NDArray[np.float32]:
    """Coefficients with the mirrored border and the row padding that `correlate` reads over.

    For a cubic spline (height + 4, width + 12), for a quintic one (height + 6, width + 14).

    Raises:
        ValueError: as `coefficients`.
    """
    _checked_image(image)
    border = icgn.border_of(order)
    height, width = image.shape
    padded = np.zeros((height + 2 * border, width + 2 * border + LANES), dtype=np.float32)
    rows = padded[border : border + height]
    rows[:, border : border + width] = image
    _filter(rows, order, border, border + width)
    for k in range(1, border + 1):
        rows[:, border - k] = rows[:, border + k]
        rows[:, border + width - 1 + k] = rows[:, border + width - 1 - k]
    for k in range(1, border + 1):
        padded[border - k] = padded[border + k]
        padded[border + height - 1 + k] = padded[border + height - 1 - k]
    return padded


def spline_line_derivative(lines: NDArray[np.float32]) -> NDArray[np.float32]:
    """Derivative of each line's interpolating cubic spline at its inner samples: (n, length) to (n, length - 2).

    Raises:
        ValueError: not C-contiguous float32 lines of at least 4 samples.
    """
    checked(lines, "lines", np.float32, (None, None))
    if lines.shape[1] < MIN_EDGE_PX:
        raise ValueError(f"lines must have at least {MIN_EDGE_PX} samples, not {lines.shape[1]}")
    c = lines.copy()
    pole, gain = spline.POLES[spline.CUBIC][0], spline.GAINS[spline.CUBIC][0]
    parallel_chunks(
        lambda first, last: spline.filter_rows(c, first, last, 0, c.shape[1], pole, gain), c.shape[0], _lines_at_once(c.shape[1])
    )
    return np.float32(0.5) * (c[:, 2:] - c[:, :-2])


def median_stencil(image: NDArray[np.float32], step: int) -> float:
    """Median amount of the second difference both ways along every so many lines of an image; those that are zero are left out.

    It is 0 if all are.

    Raises:
        ValueError: not a C-contiguous float32 image of at least 4 x 4 px.
    """
    _checked_image(image)
    height, width = image.shape
    out = np.empty(((height - 2 + step - 1) // step) * (width - 2), dtype=np.float32)
    n = subsets.noise_stencils(image, step, out)
    if n == 0:
        return 0.0
    one, other = (np.uint32(bits).view(np.float32) for bits in middle_bits(out.view(np.uint32), n))
    return float((one + other) / 2)


def gradient_products(image: NDArray[np.float32], step: int, axis: int, usable: NDArray[np.float32] | None = None) -> tuple[float, float]:
    """Means of the product of the Sobel derivative with the interpolating spline's along every so many lines, and of its square.

    Args:
        image: (height, width) float32.
        step: from one line looked at to the next.
        axis: 1 for derivatives along x (lines are rows), 0 for those along y.
        usable: same shape, 1 where the Sobel derivative counts, else 0; None counts all.

    Raises:
        ValueError: not a C-contiguous float32 image of at least 4 x 4 px.
    """
    _checked_image(image)
    counted = np.empty((0, 0), dtype=np.float32) if usable is None else checked(usable, "usable", np.float32, image.shape)
    return gradient_statistics.gradient_products(image, step, axis, counted, spline.POLES[spline.CUBIC][0], spline.GAINS[spline.CUBIC][0])


@dataclass(frozen=True, slots=True, eq=False)
class SubsetSums:
    """A reference image and what each of its subsets contributes to every correlation (see `subsets.sum_row`).

    Attributes:
        width_px: image width; the arrays below are padded along rows.
        planes: (height, 3, width + pad) float32: each row's grey levels and scaled derivatives along x and y, side by side because
            they are used together.
        valid: (height, width + pad), 1 where a pixel counts, else 0 (as the planes are there); no rows at all if every pixel counts.
        x0_px: column of the first POI.
        y0_px: row of the first POI.
        step_px: distance of neighbouring POI.
        half_px: half the subset, without its centre.
        pixels: (ny, nx) valid pixels of each subset.
        mean: (ny, nx) mean of each subset.
        norm: (ny, nx) root of its centred sum of squares.
        gradient_sum: (ny, nx, n) sums of the derivatives by the n = 6 or 12 parameters.
        gradient_image_sum: (ny, nx, n) sums of their products with the centred image.
        lower: (ny, nx, n, n) Cholesky factors of the Gauss-Newton matrices (lower triangles).
        variance_u: (ny, nx) variance of u in px^2 for noise of one grey level; zero where singular.
        variance_v: (ny, nx) variance of v likewise.
        covariance: (ny, nx) of u and v likewise.
        sssig: (ny, nx) smaller eigenvalue of the 2x2 sum of squared gradients, (grey/px)^2.
    """

    width_px: int
    planes: NDArray[np.float32]
    valid: NDArray[np.float32]
    x0_px: int
    y0_px: int
    step_px: int
    half_px: int
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


def gradients(image: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Sobel derivatives along x and y in grey per px, (height, width), zero on the frame's edge.

    Raises:
        ValueError: not a C-contiguous float32 image.
    """
    checked(image, "image", np.float32, (None, None))
    along_x = np.zeros_like(image)
    along_y = np.zeros_like(image)
    height, width = image.shape
    parallel_chunks(lambda first, last: subsets.sobel_rows(image, along_x, along_y, first, last, width), height, _lines_at_once(width))
    return along_x, along_y


def _pitch(width: int) -> int:
    """Floats from one row to the next: whole vectors may be read at a row's end."""
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
        gradient_x: same shape, derivative along x; None takes Sobel's.
        gradient_y: same shape, derivative along y, if that along x is given.
        x0_px: column of the first POI.
        y0_px: row of the first POI.
        step_px: distance of neighbouring POI.
        shape: (ny, nx).
        half_px: half the subset, without its centre.
        parameters: of the shape function, 6 (affine) or 12 (second order).
        gains: what the derivatives along x and y are multiplied with.
        valid: same shape as the image, 1 where a pixel counts, else 0.

    Raises:
        ValueError: arrays of wrong dtype, shape or layout, or a subset that leaves the image.
    """
    checked(image, "image", np.float32, (None, None))
    height, width = image.shape
    given = [] if gradient_x is None else [checked(gradient_x, "gradient_x", np.float32, (height, width))]
    if gradient_x is not None:
        given.append(checked(gradient_y, "gradient_y", np.float32, (height, width)))
    ny, nx = shape
    right = x0_px + (nx - 1) * step_px + half_px
    bottom = y0_px + (ny - 1) * step_px + half_px
    if min(ny, nx, step_px) < 1 or min(x0_px, y0_px) < half_px or right > width - 1 or bottom > height - 1:
        raise ValueError(
            f"subsets from ({x0_px - half_px}, {y0_px - half_px}) to ({right}, {bottom}) leave the {width} x {height} px image"
        )
    if parameters not in (warp.AFFINE, warp.QUADRATIC):
        raise ValueError(f"parameters must be {warp.AFFINE} or {warp.QUADRATIC}, not {parameters}")
    if valid is not None:
        checked(valid, "valid", np.float32, (height, width))
    pitch = _pitch(width)
    planes = np.empty((height, 3, pitch), dtype=np.float32)
    weights = np.zeros((0 if valid is None else height, pitch), dtype=np.float32)

    def lines(first: int, last: int) -> None:
        if valid is not None:
            weights[first:last, :width] = valid[first:last]
        subsets.fill_planes(image, weights, planes, first, last, np.float32(gains[0]), np.float32(gains[1]))
        for k, gradient in enumerate(given):
            planes[first:last, 1 + k, :width] = gradient[first:last] * np.float32(gains[k])
            if valid is not None:
                planes[first:last, 1 + k, :width] *= valid[first:last]

    parallel_chunks(lines, height, _lines_at_once(width))
    result = SubsetSums(
        width_px=width,
        planes=planes,
        valid=weights,
        x0_px=x0_px,
        y0_px=y0_px,
        step_px=step_px,
        half_px=half_px,
        pixels=np.zeros(shape),
        mean=np.zeros(shape),
        norm=np.zeros(shape),
        gradient_sum=np.zeros((*shape, parameters)),
        gradient_image_sum=np.zeros((*shape, parameters)),
        lower=np.zeros((*shape, parameters, parameters)),
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

    parallel_chunks(rows, ny, ROW_CHUNK)
    return result


@dataclass(frozen=True, slots=True, eq=False)
class Solutions:
    """State of every POI of a correlation; `correlate` writes into these arrays.

    Attributes:
        parameters: (ny, nx, 6) affine parameters (u, du/dx, du/dy, v, dv/dx, dv/dy).
        zncc: (ny, nx) zero-normalised cross-correlation before the last update.
        status: (ny, nx) uint8, PoiStatus.
        iterations: (ny, nx) int32 iterations spent on the last attempt.
        curvatures: (ny, nx, 6) second derivatives (uxx, uxy, uyy, vxx, vxy, vyy); None if they are not wanted.
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
    """Run IC-GN on the POI marked in `todo` (icgn.SKIP, SEEDED or CHAINED), writing into `solutions`.

    Args:
        reference: from `subset_sums`.
        current: the current image's `interpolator`.
        todo: (ny, nx) what to do with each POI.
        seeds: (ny, nx, 6) first guesses.
        solutions: arrays to write into; POI marked SKIP keep theirs.
        max_iterations: iterations before a POI is given up.
        tolerance_px: largest motion of a subset corner expected of the next update.
        min_zncc: correlation below which a solution is refused.
        max_travel_px: distance from the first guess at which a POI is given up.
        order: of the spline `current` was made with.

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
    whole = np.concatenate([np.ones(size, dtype=np.float32), np.zeros(LANES, dtype=np.float32)])
    ramp = np.arange(size + LANES, dtype=np.float32)
    images = (current.ravel(), current.shape[1], order, r.planes.ravel(), r.valid.ravel(), r.planes.shape[2])

    def rows(first: int, last: int) -> None:
        icgn.correlate_rows(
            first, last, *images, whole, ramp, r.width_px, r.y0_px, r.x0_px, r.step_px, r.half_px, r.pixels, r.mean, r.norm,
            r.gradient_sum, r.gradient_image_sum, r.lower, todo, seeds, max_iterations, tolerance_px, min_zncc, max_travel_px,
            s.parameters, curvatures, s.zncc, s.status, s.iterations,
        )  # fmt: skip

    parallel_chunks(rows, ny, 1)
