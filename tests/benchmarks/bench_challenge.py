"""Noise against spatial resolution, and the rigid, contrast, noise and rotation cases: ``python tests/benchmarks/bench_challenge.py``.

In the manner of the DIC Challenge, with images of our own rendered analytically (speckle of 6.7 px, or 4 px with ``--fine``;
its own images are not redistributed here):

* star: v = 0.5 cos(2 pi (y - yc) / period) px with a period that grows along x from 10 to 300 px. On the line y = yc the true
  displacement is 0.5 px everywhere. Spatial resolution is the shortest period at which 90 % of it is found, displacement
  resolution the standard deviation of repeated exposures there, and their product the metrological efficiency indicator (MEI)
  in px^2, smaller is better (Reu et al. 2022, doi:10.1007/s11340-021-00806-6; Grediac, Blaysat, Sur 2017,
  doi:10.1007/s11340-017-0279-x). For comparison the theory of a subset of that size: a subset acts as a Savitzky-Golay
  filter, sin(z)/z for affine shape functions, and sqrt(2) sigma / sqrt(sum of squared gradients) is the noise.
* samples: rigid sub-pixel shifts, a change of contrast and brightness, noise and rotation, after Samples 1 to 15 of the first
  Challenge (Reu et al. 2018, doi:10.1007/s11340-017-0349-0).
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "dic"))
from speckle import Affine, Speckle, expose

from semlive import dic

SUBSETS = (9, 11, 15, 19, 23, 27, 31, 37, 43)
AMPLITUDE_PX = 0.5
VARIANTS: dict[str, dict[str, object]] = {
    "affine, cubic": {},
    "affine, quintic": {"interpolation": "quintic"},
    "quadratic, cubic": {"shape_function": "quadratic"},
}


@dataclasses.dataclass(frozen=True, eq=False)
class Star:
    """v = 0.5 cos(2 pi (y - yc) / period(x)); reference positions of integer pixels are calculated once, to 1e-12 px."""

    width: int
    height: int
    shortest_px: float = 10.0
    longest_px: float = 300.0

    @property
    def centre_px(self) -> int:
        """Row in which the displacement is the amplitude."""
        return self.height // 2

    def period_px(self, x: NDArray) -> NDArray:
        """Period at a column."""
        return self.shortest_px + (self.longest_px - self.shortest_px) * np.clip(x / (self.width - 1.0), 0.0, 1.0)

    def displacement(self, x: NDArray, y: NDArray) -> NDArray:
        """Displacement v at reference positions."""
        return AMPLITUDE_PX * np.cos(2.0 * np.pi * (y - self.centre_px) / self.period_px(x))

    @cached_property
    def _table(self) -> NDArray[np.float64]:
        y, x = np.mgrid[0 : self.height, 0 : self.width].astype(float)
        found = y.copy()
        for _ in range(60):  # contracts by at most pi / 10 a step
            found = y - self.displacement(x, found)
        return found

    def at(self, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        """Displacement of reference positions."""
        return np.zeros_like(x), self.displacement(x, y)

    def back(self, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        """Reference positions of integer pixels."""
        return x, self._table[np.rint(y).astype(int), np.rint(x).astype(int)]


@dataclasses.dataclass(frozen=True)
class Line:
    """One row of the table; `converged` is the share of points where the period is one that the subset resolves."""

    subset_px: int
    resolution_px: float
    noise_px: float
    predicted_px: float
    stated_px: float
    converged: float

    @property
    def efficiency_px2(self) -> float:
        """Metrological efficiency indicator."""
        return self.resolution_px * self.noise_px


def star_lines(star: Star, speckles: list[Speckle], subsets: tuple[int, ...], noise: float, draws: int, options: dict) -> Iterator[Line]:
    """Measure every subset size on several patterns with repeated exposures."""
    images = [(speckle.render(), speckle.render(star)) for speckle in speckles]
    x = np.arange(star.width)
    period = star.period_px(x)
    for subset in subsets:
        half = subset // 2
        # Five rows, the middle one judged: points of a single row have too few neighbours to be compared with.
        settings = dic.DicSettings(
            subset_px=subset, step_px=1, roi_px=(half, star.centre_px - 2, star.width - 1 - half, star.centre_px + 2), **options
        )
        grid = dic.grid_for(settings, star.width, star.height)
        found, sigma, valid = (np.full((len(images), draws, grid.nx), np.nan) for _ in range(3))
        floor = []
        for i, (first, second) in enumerate(images):
            squares = (np.gradient(first, axis=0) ** 2)[star.centre_px - half : star.centre_px + half + 1].sum(axis=0)
            floor.append(np.mean(2.0 * noise**2 / np.convolve(squares, np.ones(subset), mode="valid")))
            for draw in range(draws):
                m = dic.match(expose(first, noise, 2 * draw), expose(second, noise, 2 * draw + 1), grid, settings)
                found[i, draw] = np.where(m.valid, m.v_px, np.nan)[2]
                sigma[i, draw] = m.sigma_v_px[2]
                valid[i, draw] = m.valid[2]
        columns = grid.x_px.astype(int)
        repeated = np.isfinite(found).all(axis=1)  # at (pattern, column), in every draw
        amplitude = np.where(repeated, found.mean(axis=1), 0.0).sum(axis=0) / np.maximum(repeated.sum(axis=0), 1) / AMPLITUDE_PX
        long = repeated & (period[columns] > 150.0)
        noise_px = float(np.sqrt(np.mean(np.var(found, axis=1, ddof=1)[long])))
        stated = float(np.sqrt(np.mean(np.moveaxis(sigma, 1, 2)[long] ** 2)))
        shortest = resolution(period[columns], amplitude, repeated.any(axis=0))
        yield Line(
            subset, shortest, noise_px, float(np.sqrt(np.mean(floor))), stated, float(valid[:, :, period[columns] >= shortest].mean())
        )


def resolution(period: NDArray, amplitude: NDArray, valid: NDArray) -> float:
    """Shortest period beyond which 90 % of the amplitude is found, the pattern's own bias averaged over 41 columns."""
    window = np.ones(41)
    smooth = np.convolve(amplitude, window, mode="same") / np.maximum(np.convolve(valid, window, mode="same"), 1.0)
    short = np.nonzero(smooth < 0.9)[0]
    return float(period[short[-1]]) if short.size else float(period[0])


def theory_px(subset: int) -> float:
    """Period at which a moving average of `subset` samples passes 90 % of a wave."""
    periods = np.linspace(subset, 6.0 * subset, 20_001)
    passed = np.sin(np.pi * subset / periods) / (subset * np.sin(np.pi / periods))
    return float(periods[np.argmax(passed >= 0.9)])


def samples(spot_px: float, options: dict) -> Iterator[str]:
    """Rows of the second table."""
    speckle = Speckle(400, 360, spot_px=spot_px, seed=11)
    still = speckle.render()
    cases: list[tuple[str, Affine, float, float, float]] = [
        *((f"shift {u:.2f} px", Affine(u=u, v=u), 0.0, 1.0, 0.0) for u in (0.1, 0.25, 0.5)),
        ("shift 0.30 px, noise 5 grey", Affine(u=0.3, v=0.3), 5.0, 1.0, 0.0),
        ("shift 0.30 px, noise 10 grey", Affine(u=0.3, v=0.3), 10.0, 1.0, 0.0),
        ("shift 0.30 px, contrast x 0.5, + 30 grey", Affine(u=0.3, v=0.3), 1.5, 0.5, 30.0),
        *(
            (f"rotation {degrees} degrees", _rotation(np.radians(degrees), 200.0, 180.0), 1.5, 1.0, 0.0)
            for degrees in (1, 5, 10)
        ),
        ("strain 5 %", Affine(ux=0.05, vy=-0.015, xc=200, yc=180), 1.5, 1.0, 0.0),
    ]  # fmt: skip
    for name, motion, noise, contrast, brightness in cases:
        second = 128.0 + contrast * (speckle.render(motion) - 128.0) + brightness
        settings = dic.DicSettings(subset_px=31, step_px=5, roi_px=(60, 60, 340, 300), **options)
        m = dic.match(expose(still, noise, 1), expose(second, noise, 2), settings=settings)
        true_u, true_v = motion.at(*m.grid.mesh())
        du, dv = (m.u_px - true_u)[m.valid], (m.v_px - true_v)[m.valid]
        stated = np.sqrt(np.mean(m.sigma_u_px[m.valid] ** 2))
        yield (
            f"| {name} | {100 * m.valid.mean():.1f} | {du.mean():+.1e} / {dv.mean():+.1e} | {du.std():.1e} / {dv.std():.1e} | "
            f"{stated:.1e} | {max(np.abs(du).max(), np.abs(dv).max()):.3f} |\n"
        )


def _rotation(angle: float, xc: float, yc: float) -> Affine:
    c, s = np.cos(angle), np.sin(angle)
    return Affine(ux=c - 1.0, uy=-s, vx=s, vy=c - 1.0, xc=xc, yc=yc)


def main() -> None:
    """Run and print both tables for every kind of interpolation and shape function there is."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--fine", action="store_true", help="speckle of 4 px")
    parser.add_argument("--noise", type=float, default=2.0, help="grey levels")
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--patterns", type=int, default=3)
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--subsets", type=int, nargs="+", default=SUBSETS)
    requests = parser.parse_args()
    spot_px = 1.2 if requests.fine else 2.0
    star = Star(1600, 161)
    speckles = [Speckle(star.width, star.height, spot_px=spot_px, seed=21 + k) for k in range(requests.patterns)]
    for name in requests.variants:
        options = VARIANTS[name]
        sys.stdout.write(f"\n{name}; noise {requests.noise:.0f} grey, speckle {3.33 * spot_px:.1f} px\n\n")
        sys.stdout.write("| subset px | resolution px | theory px | noise px | floor px | stated px | MEI px^2 | converged % |\n")
        sys.stdout.write("|---|---|---|---|---|---|---|---|\n")
        for r in star_lines(star, speckles, tuple(requests.subsets), requests.noise, requests.draws, options):
            sys.stdout.write(
                f"| {r.subset_px} | {r.resolution_px:.0f} | {theory_px(r.subset_px):.0f} | {r.noise_px:.4f} | {r.predicted_px:.4f} | "
                f"{r.stated_px:.4f} | {r.efficiency_px2:.3f} | {100 * r.converged:.1f} |\n"
            )
            sys.stdout.flush()
        sys.stdout.write(
            "\n| sample, subset 31 | converged % | bias u / v px | sd u / v px | stated px | worst px |\n|---|---|---|---|---|---|\n"
        )
        for text in samples(spot_px, options):
            sys.stdout.write(text)
            sys.stdout.flush()


if __name__ == "__main__":
    main()
