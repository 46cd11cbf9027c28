"""Bias, noise and stated uncertainty of the DIC: ``python tests/benchmarks/bench_dic_accuracy.py [draws] [interpolation ...]``.

One frame of speckle of 6.7 px rendered analytically, its copies shifted by 0 ... 1 px in steps of 0.1 (v the other way), subsets of 43 px
(``--subset``; ``--shape quadratic`` for a second-order shape function)
that do not overlap, so that every value counts; image noise is drawn again for both frames of every pair. Prints

- bias without noise for each shift (16 bit frames, so that rounding does not blur it),
- at 2, 5 and 10 grey levels the mean error over draws, points and shifts, its largest value over shifts, with standard errors,
- standard deviation over the floor sqrt(2) sigma / sqrt(sum of squared gradients), with its standard error,
- how many errors lie within one and 1.96 stated sigma.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "dic"))
from speckle import Affine, Speckle, expose

from semlive import dic
from semlive.data.grid import Grid
from semlive.data.settings import DicSettings

SHIFTS = np.arange(0.0, 1.01, 0.1)


@dataclass(frozen=True)
class Campaign:
    """Errors of many draws.

    Attributes:
        error_px: (2, shifts, draws, points) u and v less the truth, NaN where a point did not converge.
        sigma_px: same shape, stated standard uncertainty.
        floor_px: (2, points) least possible standard deviation.
        converged: part of the points that converged.
    """

    error_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    floor_px: NDArray[np.float64]
    converged: float

    @property
    def bias_px(self) -> NDArray[np.float64]:
        """(2, shifts) mean error."""
        return np.nanmean(self.error_px, axis=(2, 3))

    @property
    def bias_error_px(self) -> float:
        """Standard error of one of them."""
        return float(np.nanstd(self.error_px) / np.sqrt(self.error_px[0, 0].size))

    @property
    def over_floor(self) -> float:
        """Root mean square of the noise over the floor's; what does not change from draw to draw is no noise."""
        repeated = np.isfinite(self.error_px).sum(axis=2) > 1
        noise = np.nanvar(np.where(repeated[:, :, None], self.error_px, 0.0), axis=2, ddof=1)
        floor = np.broadcast_to(self.floor_px[:, None], noise.shape)
        return float(np.sqrt(np.mean(noise[repeated]) / np.mean(floor[repeated] ** 2)))

    def covered(self, factor: float) -> float:
        """Part of the errors within so many stated sigma."""
        measured = np.isfinite(self.error_px)
        return float(np.mean((np.abs(self.error_px) <= factor * self.sigma_px)[measured]))


def scene(width: int, height: int) -> list[NDArray[np.float64]]:
    """The frame at rest and one for each shift."""
    speckle = Speckle(width, height, seed=11)
    return [speckle.render(), *(speckle.render(Affine(u=s, v=-s)) for s in SHIFTS)]


def run(images: list[NDArray[np.float64]], noise: float, draws: int, *, subset: int = 43, **settings: object) -> Campaign:
    """Correlate every shift `draws` times."""
    height, width = images[0].shape
    chosen = DicSettings(subset_px=subset, step_px=subset, roi_px=(24, 24, width - 25, height - 25), **settings)  # type: ignore[arg-type]
    grid = dic.grid_for(chosen, width, height)
    bits = 8 if noise else 16
    errors = np.zeros((2, len(SHIFTS), draws, grid.nx * grid.ny))
    sigmas = np.zeros_like(errors)
    valid = 0
    for draw in range(draws):
        reference = dic.prepare(expose(images[0], noise, 1000 * draw, bits), grid, chosen)
        for k, shift in enumerate(SHIFTS):
            current = expose(images[k + 1], noise, 1000 * draw + k + 1, bits)
            m = dic.correlate(reference, current, chosen, reference_frame=0, current_frame=1)
            valid += int(m.valid.sum())
            for axis, error in enumerate((m.u_px - shift, m.v_px + shift)):
                errors[axis, k, draw] = np.where(m.valid, error, np.nan).ravel()
            sigmas[:, k, draw] = m.sigma_u_px.ravel(), m.sigma_v_px.ravel()
    return Campaign(errors, sigmas, _floor(images[0], grid, noise), valid / errors[0].size)


def _floor(image: NDArray[np.float64], grid: Grid, noise: float) -> NDArray[np.float64]:
    half = grid.subset_px // 2
    variance = noise**2 + 1.0 / 12.0  # rounding to grey levels is noise too
    floors = []
    for axis in (1, 0):
        square = np.gradient(image, axis=axis) ** 2
        points = ((int(x), int(y)) for y in grid.y_px for x in grid.x_px)
        floors.append([np.sqrt(2.0 * variance / square[y - half : y + half + 1, x - half : x + half + 1].sum()) for x, y in points])
    return np.array(floors)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("draws", nargs="?", type=int, default=30)
    parser.add_argument("interpolation", nargs="*", default=["cubic", "quintic"])
    parser.add_argument("--subset", type=int, default=43)
    parser.add_argument("--shape", choices=("affine", "quadratic", "quartic"), default="affine")
    given = parser.parse_args()
    images = scene(360, 320)
    for interpolation in given.interpolation:
        options = {"subset": given.subset, "shape_function": given.shape, "interpolation": interpolation}
        still = run(images, 0.0, 1, **options)
        curve = " ".join(f"{1e4 * b:+.2f}" for b in still.bias_px[0])
        sys.stdout.write(
            f"{interpolation}, no noise: bias of u by shift, 1e-4 px: {curve}; largest of u and v {np.abs(still.bias_px).max():.1e}\n"
        )
        for noise in (2.0, 5.0, 10.0):
            c = run(images, noise, given.draws, **options)
            values = c.error_px.size
            sys.stdout.write(
                f"{interpolation}, {noise:.0f} grey: {values} values, converged {c.converged:.4f}; "
                f"mean error {np.nanmean(c.error_px):+.1e} +- {np.nanstd(c.error_px) / np.sqrt(values):.0e}, "
                f"largest over shifts {np.abs(c.bias_px).max():.1e} +- {c.bias_error_px:.0e}; "
                f"sd {np.nanstd(c.error_px):.2e}, over floor {c.over_floor:.3f} +- {1.0 / np.sqrt(2 * values):.3f}; "
                f"within 1 sigma {100 * c.covered(1.0):.1f} %, 1.96 sigma {100 * c.covered(1.96):.1f} % "
                f"+- {100 * np.sqrt(0.22 / values):.1f}\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main()
