"""Motion of a pair: smooth displacement with drift within the frame, and shifts of single rows of both frames.

A pixel R of a frame is scanned at the beam position P = R + S(row) + J(row). S are lasting steps: all rows after a step are shifted by
it. J is the shift of a single row, without slow parts. The material point at P of the
first frame is at P + d(P) in the second, and d is smooth. The true displacement of a pixel contains d and S, and not J: slow parts of the
row shifts could not be separated from drift, so J has none. The mean of J over 43 rows has a standard deviation of 0.04 of that of one row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from .textures import HEIGHT_PX, WIDTH_PX, Field

SLOW_ROWS = 3.0  # standard deviation of the weights whose mean is taken out of the row shifts
FIXED_POINT_STEPS = 25  # gradients of at most 0.05 leave 1e-30 px


@dataclass(frozen=True, slots=True, eq=False)
class Displacement:
    """Smooth displacement d = shift + gradient (P - centre) + drift over rows + waves.

    Attributes:
        shift_px: (2,) along x and y.
        gradient: (2, 2).
        drift_px: (2, 2) first and second order of the drift along x and y, over half the rows.
        wave_px: (2,) amplitude of a wave of the length of the frame.
        phase_rad: (2, 2) its phases.
    """

    shift_px: Field
    gradient: Field
    drift_px: Field
    wave_px: Field
    phase_rad: Field

    def at(self, x_px: Field, y_px: Field) -> tuple[Field, Field]:
        """Displacement at beam positions of the first frame."""
        cx, cy = x_px - WIDTH_PX / 2, y_px - HEIGHT_PX / 2
        t = 2.0 * cy / HEIGHT_PX
        out = []
        for k in range(2):
            wave = np.sin(2.0 * np.pi * cx / WIDTH_PX + self.phase_rad[k, 0]) * np.cos(np.pi * cy / HEIGHT_PX + self.phase_rad[k, 1])
            drift = self.drift_px[k, 0] * t + self.drift_px[k, 1] * t**2
            out.append(self.shift_px[k] + self.gradient[k, 0] * cx + self.gradient[k, 1] * cy + drift + self.wave_px[k] * wave)
        return out[0], out[1]

    def inverse(self, x_px: Field, y_px: Field) -> tuple[Field, Field]:
        """Beam positions of the first frame whose material is at these positions of the second."""
        x, y = x_px, y_px
        for _ in range(FIXED_POINT_STEPS):
            u, v = self.at(x, y)
            x, y = x_px - u, y_px - v
        return x, y


def random_displacement(rng: np.random.Generator, drift_px: float = 3.0, shift_px: float = 8.0, strain: float = 0.006) -> Displacement:
    """Draw a displacement; drift is up to `drift_px` over half the rows."""
    return Displacement(
        rng.uniform(-shift_px, shift_px, 2),
        rng.uniform(-strain, strain, (2, 2)),
        rng.uniform(-drift_px, drift_px, (2, 2)) * (1.0, 0.3),
        rng.uniform(-0.3, 0.3, 2),
        rng.uniform(0.0, 2.0 * np.pi, (2, 2)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class RowMotion:
    """Shifts of the rows of one frame, px.

    Attributes:
        single: (2, height) J along x and y.
        steps: (2, height) S along x and y, constant between steps.
        sd_px: (2,) standard deviation of J without jumps.
        jumped: (height,) which single rows jump.
    """

    single: Field
    steps: Field
    sd_px: Field
    jumped: NDArray[np.bool_]

    @property
    def step_rows(self) -> NDArray[np.int64]:
        """First rows after a step."""
        return np.nonzero(np.any(np.diff(self.steps, axis=1) != 0.0, axis=0))[0] + 1


def slow_part(rows: int) -> Field:
    """(rows, rows) matrix of the weights that take the slow part out of row shifts."""
    return np.asarray(ndimage.gaussian_filter1d(np.eye(rows), SLOW_ROWS, axis=0, mode="constant"))


def random_rows(
    rng: np.random.Generator, jitter_px: float = 0.0, steps: int = 0, step_px: tuple[float, float] = (2.0, 6.0), single_jumps: int = 0
) -> RowMotion:
    """Draw the row shifts of one frame.

    Args:
        rng: generator of random numbers.
        jitter_px: standard deviation of the shift of a row along x; along y it is a quarter of it.
        steps: number of lasting steps.
        step_px: smallest and largest step along x; along y it is up to a fifth of it.
        single_jumps: number of single rows that are shifted by 2 to 6 px along x.
    """
    sd = np.array([jitter_px, 0.25 * jitter_px])
    white = rng.standard_normal((2, HEIGHT_PX + 80))
    fast = (white - ndimage.gaussian_filter1d(white, SLOW_ROWS, axis=1))[:, 40:-40]
    single = sd[:, None] * fast / fast.std(axis=1, keepdims=True)
    jumped = np.zeros(HEIGHT_PX, bool)
    jumped[rng.choice(HEIGHT_PX, single_jumps, replace=False)] = True
    single[0, jumped] += rng.uniform(2.0, 6.0, single_jumps) * rng.choice([-1.0, 1.0], single_jumps)
    lasting = np.zeros((2, HEIGHT_PX))
    for _ in range(steps):
        size = rng.uniform(*step_px) * rng.choice([-1.0, 1.0])
        lasting[:, int(rng.integers(60, HEIGHT_PX - 60)) :] += np.array([[size], [rng.uniform(-0.2, 0.2) * size]])
    return RowMotion(single, lasting, sd, jumped)


def pixels() -> tuple[Field, Field]:
    """x and y of every pixel, (height, width)."""
    y, x = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(float)
    return x, y


def beam(rows: RowMotion, *, jitter: bool = True) -> tuple[Field, Field]:
    """Beam position of every pixel of a frame, (height, width); without single-row shifts if not `jitter`."""
    x, y = pixels()
    dx, dy = rows.steps + rows.single if jitter else rows.steps
    return x + dx[:, None], y + dy[:, None]


def true_displacement(motion: Displacement, first: RowMotion, second: RowMotion) -> tuple[Field, Field]:
    """(height, width) displacement u, v of every pixel of the first frame, steps included and single-row shifts not."""
    x, y = pixels()
    px, py = beam(first, jitter=False)
    u, v = motion.at(px, py)
    px, py = px + u, py + v
    qx, qy = px, py
    for _ in range(3):  # the step at the row of the second frame: rows next to a step are not unique and lie in its transition
        row = np.clip(np.rint(qy), 0, HEIGHT_PX - 1).astype(int)
        qx, qy = px - second.steps[0, row], py - second.steps[1, row]
    return qx - x, qy - y
