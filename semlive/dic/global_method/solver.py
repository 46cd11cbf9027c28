"""Gauss-Newton solution of the regularised field; noise, smoothness and size of the row shifts are estimated from the data.

Residual of a pixel: ``g(x + u, y + v) - f(x, y) - a(y) - b(y) f(x, y)`` with row offset a and row gain b; u and v are the field plus a
shift of each row. Minimised: the weighted squares, plus bending energy of u and of v, plus the squared row shifts over their variance.
The smoothness follows from the data by the update of Fellner and Schall (Wood, Fasiolo 2017, doi:10.1111/biom.12640), the variance of
the row shifts by expectation maximisation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.dic.global_method import block_tridiagonal
from semlive.dic.global_method.noise import pixels_per_independent, robust_weight, row_levels, variance_map
from semlive.dic.global_method.normal_equations import Equations, assemble, row_unknowns, to_fields, to_vector
from semlive.dic.global_method.spline_field import Lattice
from semlive.kernels.splines.spline_sampling import sample

Array = NDArray[np.float64]
Image = NDArray[np.float32]

FIRST_SMOOTHNESS = 1e4  # precision of the bending energy, 1/px^2; only a start
SMOOTHNESS_RANGE = (1e-2, 1e9)
SMOOTHNESS_STEP = 10.0  # largest factor in one iteration
FIRST_ROW_VARIANCE = 0.01  # px^2
ROW_VARIANCE_RANGE = (1e-6, 1.0)  # px^2
ROW_GAIN_SD = 0.2  # prior of the gain of a row relative to 1
LARGEST_STEP_PX = 3.0
SETTLED_PX = 0.005
MIN_ITERATIONS = 4
TINY = 1e-9  # relative ridge


@dataclass(frozen=True, slots=True, eq=False)
class FramePair:
    """Two filtered frames.

    Attributes:
        reference: (height, width) filtered reference.
        coefficients: (height, width) cubic spline of the filtered current frame.
        used: (height, width) 1 where the reference may be used, else 0.
        margin_px: distance from the border of the current frame within which the filter contains no data.
    """

    reference: Image
    coefficients: Image
    used: Image
    margin_px: float


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """Field and row shifts with their hyperparameters.

    Attributes:
        lattice: control points.
        control_px: (2, ny, nx) u and v at the control points.
        row_shift_px: (height, 2) shift of each row along x and y.
        smoothness: (2,) precision of the bending energy of u and v.
        row_variance_px2: (2,) variance of the row shifts along x and y.
    """

    lattice: Lattice
    control_px: Array
    row_shift_px: Array
    smoothness: Array
    row_variance_px2: Array

    def displacement(self, *, rows: bool = False) -> tuple[Array, Array]:
        """(height, width) u and v in px, with the row shifts if `rows`."""
        u, v = (self.lattice.evaluate(c) for c in self.control_px)
        return (u + self.row_shift_px[:, :1], v + self.row_shift_px[:, 1:]) if rows else (u, v)

    def on(self, lattice: Lattice) -> Field:
        """The field on other control points of the same frame."""
        return replace(self, lattice=lattice, control_px=np.stack([lattice.fitted(values) for values in self.displacement()]))


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Field with what its uncertainty needs.

    Attributes:
        field: the solution.
        factor: factor of the posterior information matrix of the control points.
        weight: (height, width) weight of each pixel, 1/grey^2, correlation of the residual included; zero where not used.
        residual: (height, width) residual without row offset and gain.
        warped: (height, width) filtered current frame at the displaced positions.
        gradient: (height, width) each, derivatives along x and y.
        used: (height, width) 1 where both frames are known.
    """

    field: Field
    factor: block_tridiagonal.Factor
    weight: Image
    residual: Image
    warped: Image
    gradient: tuple[Image, Image]
    used: Image


def first_field(lattice: Lattice, control_px: Array) -> Field:
    """Field without row shifts, with the first values of the hyperparameters."""
    shape = (lattice.shape[0], 2)
    return Field(lattice, control_px, np.zeros(shape), np.full(2, FIRST_SMOOTHNESS), np.full(2, FIRST_ROW_VARIANCE))


def refine(pair: FramePair, field: Field, iterations: int) -> Solution:
    """Iterate until no control point moves by more than SETTLED_PX.

    Args:
        pair: filtered frames.
        field: initial field.
        iterations: maximum number of iterations.

    Raises:
        LinAlgError: the frames share no usable area.
    """
    along_y, along_x = (np.asarray(part, dtype=np.float32) for part in np.gradient(pair.reference))
    reference_gradient = (along_x, along_y)
    contrast = float(np.mean(pair.reference[pair.used > 0.0] ** 2)) + 1e-6
    solution: Solution | None = None
    for iteration in range(iterations):
        warped, gradient, used = _warp(pair, field, reference_gradient)
        residual = (warped - pair.reference) * used
        offset, gain = row_levels(residual, pair.reference, used)
        noise = np.asarray((residual - offset[:, None] - gain[:, None] * pair.reference) * used, dtype=np.float32)
        weight = robust_weight(noise, used, variance_map(noise, used))
        weight = np.asarray(weight / pixels_per_independent(noise, gradient, weight), dtype=np.float32)
        prior = np.concatenate([[1e-6 / contrast, ROW_GAIN_SD**-2], 1.0 / field.row_variance_px2])
        offsets = np.pad(field.row_shift_px, ((0, 0), (2, 0)))
        equations = assemble(field.lattice, pair.reference, residual, gradient, weight, prior, offsets)
        field, factor, moved_px = _step(field, equations, used)
        solution = Solution(field, factor, weight, noise, warped, gradient, used)
        if moved_px < SETTLED_PX and iteration + 1 >= MIN_ITERATIONS:
            break
    assert solution is not None
    return solution


def _warp(pair: FramePair, field: Field, reference_gradient: tuple[Image, Image]) -> tuple[Image, tuple[Image, Image], Image]:
    height, width = pair.reference.shape
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    u, v = field.displacement(rows=True)
    at_x, at_y = (np.ascontiguousarray(values, dtype=np.float32) for values in (x + u, y + v))
    warped, along_x, along_y, inside = sample(pair.coefficients, at_x, at_y)
    m = pair.margin_px
    inside &= (at_x >= m) & (at_x <= width - 1 - m) & (at_y >= m) & (at_y <= height - 1 - m)
    used = np.asarray(inside * pair.used, dtype=np.float32)
    # The mean of both derivatives: noise in one of them alone would shorten the steps and correlate with the residual.
    gradient = tuple(np.asarray(0.5 * (a + b), dtype=np.float32) for a, b in zip((along_x, along_y), reference_gradient, strict=True))
    return warped, (gradient[0], gradient[1]), used


def _step(field: Field, equations: Equations, used: Image) -> tuple[Field, block_tridiagonal.Factor, float]:
    """One step with the present weights, and the hyperparameters after it."""
    lattice = field.lattice
    (ny, nx), (bending, bending_next) = lattice.counts, lattice.bending
    diagonal, upper, right = equations.diagonal.copy(), equations.upper.copy(), equations.right.copy()
    present = to_vector(lattice, field.control_px)
    components = [slice(k * 3 * nx, (k + 1) * 3 * nx) for k in range(2)]
    for part, smoothness in zip(components, field.smoothness, strict=True):
        diagonal[:, part, part] += smoothness * bending
        upper[:, part, part] += smoothness * bending_next
        right[:, part] -= smoothness * block_tridiagonal.product(bending, bending_next, present[:, part])
    unknowns = np.arange(6 * nx)
    diagonal[:, unknowns, unknowns] += TINY * float(np.mean(np.einsum("kii->ki", diagonal)))
    factor = block_tridiagonal.factor(diagonal, upper)
    step = to_fields(lattice, block_tridiagonal.solve(factor, right))
    largest = float(np.max(np.abs(step)))
    if largest > LARGEST_STEP_PX:
        step *= LARGEST_STEP_PX / largest
    row_step, row_posterior = row_unknowns(equations, lattice, step)
    covariance = block_tridiagonal.inverse_blocks(factor)
    control = field.control_px + step
    moved = to_vector(lattice, control)
    smoothness = np.empty(2)
    for k, part in enumerate(components):
        trace = np.einsum("kij,kji->", covariance[0][:, part, part], bending)
        trace += 2.0 * np.einsum("kij,kij->", covariance[1][:, part, part], bending_next)
        energy = float(np.sum(moved[:, part] * block_tridiagonal.product(bending, bending_next, moved[:, part])))
        present_value = field.smoothness[k]
        degrees = max(ny * nx - 3 - present_value * float(trace), 1e-3)
        smoothness[k] = np.clip(degrees / max(energy, 1e-12), present_value / SMOOTHNESS_STEP, present_value * SMOOTHNESS_STEP)
    rows = field.row_shift_px + row_step[:, 2:]
    visible = used.sum(axis=1) > 0.1 * used.shape[1]
    variance = np.mean((rows**2 + row_posterior[:, 2:])[visible], axis=0) if visible.any() else field.row_variance_px2
    next_field = Field(lattice, control, rows, np.clip(smoothness, *SMOOTHNESS_RANGE), np.clip(variance, *ROW_VARIANCE_RANGE))
    return next_field, factor, largest
