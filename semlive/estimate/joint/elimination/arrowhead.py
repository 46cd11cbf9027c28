"""Linear algebra of the information matrix: parameters acting along x and along y are coupled only by a few shared parameters.

Distortion, drift and shifts have separate parameters for each component; rotations, raster terms and scan axes are shared. In this
order the matrix is an arrowhead of two large blocks and a narrow border. Its factorisation takes a quarter of the time of a full matrix.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve, get_lapack_funcs, solve_triangular

from semlive.errors import IllPosed
from semlive.estimate.joint.observations.state import EstimatorState
from semlive.kernels import linear_algebra
from semlive.kernels.linear_algebra import forward_substitution
from semlive.model import MotionKind

ROUNDING = 1e-14
MIRROR = 128  # parameters

Matrix = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class ComponentBlocks:
    """Joint parameter indices by the component they act on.

    Attributes:
        x: indices acting on x only.
        y: indices acting on y only.
        shared: indices acting on both.
    """

    x: Indices
    y: Indices
    shared: Indices

    @property
    def own(self) -> tuple[Indices, Indices]:
        """Indices acting on x only, and on y only."""
        return self.x, self.y


def sides(state: EstimatorState) -> ComponentBlocks:
    """Component blocks of all parameters of a state."""
    kind = np.full(state.layout.size, 2, dtype=np.int8)
    for name in ("distortion", "drift") if state.drift is not None else ("distortion",):
        part = state.layout.part(name)
        kind[part.start : part.stop : 2], kind[part.start + 1 : part.stop : 2] = 0, 1
    kind[state.layout.part("line_shift")] = 0
    motion = [value for kind in state.motions.kinds for value in ((0, 1, 2) if kind is MotionKind.RIGID else (0, 0, 0, 1, 1, 1))]
    kind[state.layout.part("motion")] = motion
    return ComponentBlocks(*(np.flatnonzero(kind == value) for value in (0, 1, 2)))


@dataclass(frozen=True, slots=True, eq=False)
class ArrowheadFactor:
    """Cholesky factor of an arrowhead matrix.

    Attributes:
        sides: indices of the blocks.
        block: lower factors of the blocks of x and y.
        coupling: inverse factor of each block times its coupling to the border.
        border: lower factor of the Schur complement of the border.
    """

    sides: ComponentBlocks
    block: tuple[Matrix, Matrix]
    coupling: tuple[Matrix, Matrix]
    border: Matrix

    @property
    def half_log_det(self) -> float:
        """Half the log determinant of the matrix."""
        return sum(float(np.sum(np.log(np.diag(value)))) for value in (*self.block, self.border))

    def half(self, right: Matrix) -> Matrix:
        """(n,) or (n, k) forward substitution in the order x, y, shared. The product of two results is a quadratic form of the inverse."""
        ahead, remainder = self._ahead(right)
        return np.concatenate((*ahead, forward_substitution(self.border, remainder)))

    def solve(self, right: Matrix) -> Matrix:
        """(n,) or (n, k) solution."""
        ahead, remainder = self._ahead(right)
        shared = cho_solve((self.border, True), remainder, check_finite=False)
        total = np.empty_like(right)
        total[self.sides.shared] = shared
        for low, join, value, at in zip(self.block, self.coupling, ahead, self.sides.own, strict=True):
            total[at] = solve_triangular(low, value - join @ shared, lower=True, trans=1, check_finite=False)
        return total

    def _ahead(self, right: Matrix) -> tuple[list[Matrix], Matrix]:
        """Forward substitution of both blocks, and the remaining right side of the border."""
        ahead = [_half(low, right[at]) for low, at in zip(self.block, self.sides.own, strict=True)]
        return ahead, right[self.sides.shared] - sum(join.T @ value for join, value in zip(self.coupling, ahead, strict=True))

    def trace_of_inverse_with(self, other: Matrix) -> float:
        """Trace of the inverse times another symmetric arrowhead matrix (n, n), whose blocks of x and y are not coupled either.

        The blocks of the inverse between x and y, and the order of its parameters, are not needed: a third of the time of the inverse.
        """
        shared, border = self.sides.shared, inverse(self.border)
        total = float(np.vdot(border, other[np.ix_(shared, shared)]))
        for low, join, at in zip(self.block, self.coupling, self.sides.own, strict=True):
            reach = solve_triangular(low, join, lower=True, trans=1, check_finite=False)
            through, coupled = reach @ border, other[np.ix_(at, shared)]
            own = other[np.ix_(at, at)]
            total += float(np.vdot(inverse(low), own)) + float(np.vdot(own @ reach - 2.0 * coupled, through))
        return total

    def inverse(self) -> Matrix:
        """(n, n) inverse, symmetric."""
        border = inverse(self.border)
        reach = [
            solve_triangular(low, join, lower=True, trans=1, check_finite=False)
            for low, join in zip(self.block, self.coupling, strict=True)
        ]
        (x, y), shared = self.sides.own, self.sides.shared
        through = [value @ border for value in reach]
        ordered = np.block(
            [
                [inverse(self.block[0]) + through[0] @ reach[0].T, through[0] @ reach[1].T, -through[0]],
                [through[1] @ reach[0].T, inverse(self.block[1]) + through[1] @ reach[1].T, -through[1]],
                [-through[0].T, -through[1].T, border],
            ]
        )
        back = np.argsort(np.concatenate((x, y, shared)))
        return ordered[back][:, back]


def _half(low: Matrix, right: Matrix) -> Matrix:
    """Triangular solution that skips right sides equal to zero, such as those of the other component."""
    if right.ndim == 1 or not right.size:
        return forward_substitution(low, right)
    nonzero = right.any(axis=0)
    if nonzero.all():
        return forward_substitution(low, right)
    found = np.zeros_like(right)
    found[:, nonzero] = forward_substitution(low, right[:, nonzero])
    return found


def factorise(precision: Matrix, where: ComponentBlocks, rounding: float = ROUNDING) -> ArrowheadFactor:
    """Factorise a precision matrix.

    Args:
        precision: (n, n) matrix without coupling between x and y.
        where: indices of the blocks.
        rounding: fraction of the diagonal added to it.

    Raises:
        IllPosed: the matrix is not finite or not positive definite.
    """
    block, joined = [], []
    border = regularise(precision[np.ix_(where.shared, where.shared)], rounding)
    for at in where.own:
        low = _cholesky_of_rows(precision, at, rounding)
        join = forward_substitution(low, precision[np.ix_(at, where.shared)])
        border -= join.T @ join
        block.append(low)
        joined.append(join)
    return ArrowheadFactor(where, (block[0], block[1]), (joined[0], joined[1]), cholesky(border))


def marginalise(
    precision: Matrix, pull: NDArray[np.float64], where: ComponentBlocks, eliminated: NDArray[np.bool_]
) -> tuple[Matrix, NDArray[np.float64]]:
    """Precision and gradient of the remaining parameters (x, y, then shared) after marginalising those marked in `eliminated` (n,)."""
    stay = ~eliminated
    shared_gone = where.shared[eliminated[where.shared]]
    retained = np.concatenate((np.flatnonzero(stay), shared_gone))
    place = np.full(len(pull), -1)
    place[retained] = np.arange(len(retained))
    reduced, gradient = precision[np.ix_(retained, retained)], pull[retained]
    for at in where.own:
        out, touched = at[eliminated[at]], np.concatenate((at[stay[at]], where.shared))
        if not out.size:
            continue
        right = np.column_stack((precision[np.ix_(out, touched)], pull[out]))
        join = forward_substitution(_cholesky_of_rows(precision, out), right)
        inside = place[touched]
        reduced[np.ix_(inside, inside)] -= join[:, :-1].T @ join[:, :-1]
        gradient[inside] -= join[:, :-1].T @ join[:, -1]
    count = int(stay.sum())
    if shared_gone.size:
        shared = reduced[count:, count:] + np.diag(ROUNDING * np.diag(precision)[shared_gone])
        join = forward_substitution(cholesky(shared), np.column_stack((reduced[count:, :count], gradient[count:])))
        return reduced[:count, :count] - join[:, :-1].T @ join[:, :-1], gradient[:count] - join[:, :-1].T @ join[:, -1]
    return reduced[:count, :count], gradient[:count]


def cholesky(precision: Matrix) -> Matrix:
    """Lower Cholesky factor.

    Raises:
        IllPosed: the matrix is not finite or not positive definite.
    """
    try:
        return linear_algebra.cholesky(precision)
    except LinAlgError as error:
        raise _unknown() from error


def _cholesky_of_rows(precision: Matrix, at: Indices, rounding: float = ROUNDING) -> Matrix:
    """Lower Cholesky factor of the block of the parameters `at`, regularised."""
    try:
        return linear_algebra.cholesky_of_rows(precision, at, 1.0 + rounding)
    except LinAlgError as error:
        raise _unknown() from error


def inverse(factor: Matrix) -> Matrix:
    """Inverse from a lower Cholesky factor, symmetric."""
    if not factor.size:
        return np.zeros_like(factor)
    (potri,) = get_lapack_funcs(("potri",), (factor,))
    lower, _ = potri(factor, lower=1)
    for start in range(0, len(lower), MIRROR):  # in pieces: transposing at once misses the cache and takes as long as inverting
        stop = start + MIRROR
        square = lower[start:stop, start:stop]
        lower[start:stop, start:stop] = np.tril(square) + np.tril(square, -1).T
        lower[start:stop, stop:] = lower[stop:, start:stop].T
    return lower


def regularise(precision: Matrix, rounding: float = ROUNDING) -> Matrix:
    """The matrix plus the possible rounding error on its diagonal, so that directions without data do not become negative."""
    total = precision.copy()
    np.einsum("ii->i", total)[...] *= 1.0 + rounding
    return total


def _unknown() -> IllPosed:
    return IllPosed(
        "drift, distortion and motion cannot be estimated from the pairs so far: their equations are singular, or a map contains numbers "
        "that are not finite"
    )
