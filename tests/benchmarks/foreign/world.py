"""A tensile series as displacement maps: drift over scan time, distortion, shifts, strain, and the noise of an engine.

Written for semlive's tests from the first principles of a raster, without any code of the estimator, the diagnosis or the simulators.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from foreign.effects import Hidden, Visit
from foreign.noise import Shape, noise_of
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

Array = NDArray[np.float64]
HEAD = "frame,pair,phase,start_s,dwell_s,row_time_s,width,height,integrations,load_n,shift_x_px,shift_y_px"


@dataclass(frozen=True, slots=True)
class Raster:
    """Size, timing and grid of points.

    Attributes:
        width: px.
        height: px.
        dwell_s: dwell time, s.
        row_s: row time, s.
        step_px: distance of points, px.
        margin_px: distance of the outer points from the border, px.
    """

    width: int = 1024
    height: int = 884
    dwell_s: float = 1e-4
    row_s: float = 0.1071
    step_px: int = 20
    margin_px: int = 80


@dataclass(frozen=True, slots=True)
class Series:
    """What varies from run to run.

    Attributes:
        seed: of everything.
        calibration: number of calibration pairs.
        tension: number of pairs under load.
        sigma_px: standard deviation of a map's component, px.
        drift_px: drift over the run, px.
        distortion_px: largest distortion, px.
        raster: size, timing and grid.
        bias_px: amplitude of the own bias of the engine in every map that it measured, a wave over the fraction of a pixel, px.
    """

    seed: int
    calibration: int = 6
    tension: int = 5
    sigma_px: float = 0.02
    drift_px: float = 12.0
    distortion_px: float = 1.5
    raster: Raster = Raster()
    bias_px: float = 0.0

    @property
    def end_s(self) -> float:
        """End of the run, s, if every pause takes its mean."""
        frame_s = self.raster.height * self.raster.row_s
        return (self.calibration + self.tension) * (2.0 * frame_s + 105.0)


def write(series: Series, shape: Shape, folder: Path, hidden: Hidden | None = None) -> Path:
    """Write a folder for ``semlive import`` and return it.

    Args:
        series: the run.
        shape: noise of the engine.
        folder: folder to make.
        hidden: an effect of the beam that no model contains.
    """
    folder.mkdir(parents=True)
    rng, raster = np.random.default_rng((series.seed, 90)), series.raster
    pairs, begin_s = series.calibration + series.tension, 0.0
    frame_s = raster.height * raster.row_s
    starts = np.cumsum([0.0, *(gap for _ in range(pairs) for gap in (frame_s, frame_s + rng.uniform(60.0, 150.0)))])[:-1] + begin_s
    drift, distortion = _drift(series, float(starts[-1]) + frame_s, rng), _distortion(series, rng)
    shifts = _shifts(series, rng)
    strains = [0.0] * series.calibration + [0.0015 * (k + 1) / max(series.tension, 1) for k in range(series.tension)]
    x, y = np.meshgrid(
        *(np.arange(raster.margin_px, n - raster.margin_px, raster.step_px, dtype=float) for n in (raster.width, raster.height))
    )

    def observed(frame: int, material: tuple[Array, Array]) -> tuple[Array, Array]:
        """Address at which a material point appears in a frame: drift at the time at which the beam is there."""
        pair = frame // 2
        cx, cy = material[0] - raster.width / 2, material[1] - raster.height / 2
        ideal = (material[0] - 0.3 * strains[pair] * cx + shifts[pair][0], material[1] + strains[pair] * cy + shifts[pair][1])
        at = ideal
        for _ in range(12):
            time_s = starts[frame] + at[1] * raster.row_s + at[0] * raster.dwell_s
            dx, dy = distortion(*at)
            visit = Visit(*at, time_s, material, (dx, dy), (raster.width, raster.height))
            extra = hidden(visit) if hidden else (0.0, 0.0)
            at = (ideal[0] + drift[0](time_s) + dx + extra[0], ideal[1] + drift[1](time_s) + dy + extra[1])
        return at

    def material_of(frame: int, address: tuple[Array, Array]) -> tuple[Array, Array]:
        point = address
        for _ in range(12):
            back = observed(frame, point)
            point = (point[0] + address[0] - back[0], point[1] + address[1] - back[1])
        return point

    frame_noise = noise_of(shape, (raster.height, raster.width), 2 * pairs, series.sigma_px / np.sqrt(2.0), rng)
    frame_pairs = [(2 * k, 2 * k + 1) for k in range(pairs)] + [(0, 2 * k) for k in range(1, pairs)]
    frame_pairs += [] if shape.composed else [(0, 2 * k + 1) for k in range(1, pairs)]
    for number, (reference, current) in enumerate(frame_pairs):
        at = observed(current, material_of(reference, (x, y)))
        u, v = (moved + series.bias_px * np.sin(2.0 * np.pi * moved) for moved in (at[0] - x, at[1] - y))
        if shape.own:
            own = noise_of(shape, (raster.height, raster.width), 1, series.sigma_px, np.random.default_rng((series.seed, 91, number)))[0]
            noise = [_sample(own[axis], x, y) for axis in (0, 1)]
        else:
            there, here = frame_noise[current], frame_noise[reference]
            noise = [_sample(there[axis], *at) - _sample(here[axis], x, y) for axis in (0, 1)]
        valid = _found(shape, x.shape, rng)
        _write_map(folder / f"disparity_{reference}_{current}.csv", x, y, u + noise[0], v + noise[1], valid)
    _write_frames(folder / "frames.csv", series, starts, strains, shifts)
    return folder


def _sample(field: NDArray[np.float32], x: Array, y: Array) -> Array:
    return np.asarray(map_coordinates(field, [y, x], order=0, mode="grid-wrap"), dtype=float)


def _drift(series: Series, end_s: float, rng: np.random.Generator) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """Creep: two relaxations and a constant rate, without any period."""

    def one() -> Callable[[Array], Array]:
        sizes, tau_s = rng.normal(0.0, series.drift_px, 3) * (1.0, 0.3, 0.5), end_s * rng.uniform((0.4, 0.1), (1.5, 0.4))

        def at(time_s: Array) -> Array:
            fast = sizes[0] * -np.expm1(-time_s / tau_s[0]) + sizes[1] * -np.expm1(-time_s / tau_s[1])
            return np.asarray(fast + sizes[2] * time_s / end_s)

        return at

    return one(), one()


def _distortion(series: Series, rng: np.random.Generator) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Polynomials of the second and third order and one broad bump."""
    raster = series.raster
    size = series.distortion_px * rng.normal(size=(2, 8)) / np.array([2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0, 4.0])
    middle, width = rng.uniform(-0.5, 0.5, 2), rng.uniform(0.5, 0.9)

    def at(px: Array, py: Array) -> tuple[Array, Array]:
        a, b = 2.0 * px / raster.width - 1.0, 2.0 * py / raster.height - 1.0
        bump = np.exp(-((a - middle[0]) ** 2 + (b - middle[1]) ** 2) / (2.0 * width**2))
        terms = np.stack([a * a, a * b, b * b, a**3, a * a * b, a * b * b, b**3, bump])
        return np.einsum("k,kyx->yx", size[0], terms), np.einsum("k,kyx->yx", size[1], terms)

    return at


def _shifts(series: Series, rng: np.random.Generator) -> Array:
    """(pairs, 2) where the stage gets to, px: no shift in pair 0, a spread over +-40 px in calibration, small errors under load."""
    pairs = series.calibration + series.tension
    angle = 2.399963 * np.arange(pairs)
    radius = np.where(np.arange(pairs) < series.calibration, 40.0 * np.sqrt(np.arange(pairs) / max(series.calibration - 1, 1)), 0.0)
    shift = radius[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1) + rng.normal(0.0, 1.5, (pairs, 2))
    shift[0] = 0.0
    return shift


def _found(shape: Shape, size: tuple[int, int], rng: np.random.Generator) -> NDArray[np.bool_]:
    found = rng.uniform(size=size) >= 0.5 * shape.lost
    if shape.lost:
        ny, nx = size
        high, wide = (max(1, round(n * np.sqrt(0.5 * shape.lost))) for n in size)
        top, x0 = int(rng.integers(0, ny - high + 1)), int(rng.integers(0, nx // 8 + 1))
        found[top : top + high, x0 : x0 + wide] = False
    return found


def _write_map(path: Path, x: Array, y: Array, u: Array, v: Array, valid: NDArray[np.bool_]) -> None:
    lines = [
        f"{a:.0f},{b:.0f},{c:.5f},{d:.5f},{e:d}" for a, b, c, d, e in zip(*(part.ravel() for part in (x, y, u, v, valid)), strict=True)
    ]
    path.write_text("\n".join(["x,y,u,v,valid", *lines, ""]))


def _write_frames(path: Path, series: Series, starts: Array, strains: list[float], shifts: Array) -> None:
    raster, lines = series.raster, [HEAD]
    for frame, start_s in enumerate(starts):
        pair = frame // 2
        phase, load = ("calibration", "") if pair < series.calibration else ("tension", repr(7.11e5 * strains[pair]))
        shift_cells = f"{round(shifts[pair][0])},{round(shifts[pair][1])}" if pair < series.calibration else "0,0"
        lines.append(
            f"{frame},{pair},{phase},{float(start_s)!r},{raster.dwell_s},{raster.row_s},{raster.width},{raster.height},1,{load},{shift_cells}"
        )
    path.write_text("\n".join([*lines, ""]))
