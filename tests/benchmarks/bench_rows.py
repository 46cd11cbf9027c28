"""Speed and precision of row registration: ``python tests/benchmarks/bench_rows.py``.

A 1024 x 884 px pair, 8 bit, rendered analytically with row jitter of its own in each frame, or mains hum, at 2, 5 and 10 % of
full scale image noise (5, 13 and 26 grey levels on a contrast of 39).
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "dic"))
from speckle import Speckle, expose

from semlive import dic
from semlive.data.settings import DicSettings
from semlive.dic.row_registration import register_rows, row_jitter


@dataclass(frozen=True, eq=False)
class RowMotion:
    """Every row of the frame displaced by its own amount, on top of a uniform shift."""

    row_u: NDArray[np.float64]
    u: float = 0.0
    v: float = 0.0

    def at(self, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        """Displacement of reference positions, to the nearest px."""
        return np.full_like(x, self.u), np.full_like(y, self.v)

    def back(self, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
        """Reference positions of pixels, exact."""
        return x - self.u - self.row_u[np.rint(y).astype(int)], y - self.v


def main() -> None:
    """Run and print."""
    width, height = (256, 221) if "smoke" in sys.argv[1:] else (1024, 884)
    speckle = Speckle(width, height)
    settings = DicSettings()
    grid = dic.grid_for(settings, width, height)
    rng = np.random.default_rng(3)
    still, hum = np.zeros(height), 0.02 * np.sin(2.0 * np.pi * 50.0 * 0.1071 * np.arange(height) + 0.4)
    for name, first_rows, second_rows, v in (
        ("still", still, still, 0.0),
        ("jitter 0.030", 0.03 * rng.standard_normal(height), 0.03 * rng.standard_normal(height), 0.0),
        ("jitter 0.030, half a row of drift", 0.03 * rng.standard_normal(height), 0.03 * rng.standard_normal(height), 0.5),
        ("hum 0.020", still, hum, 0.0),
    ):
        first, second = speckle.render(RowMotion(first_rows)), speckle.render(RowMotion(second_rows, 0.3, v))
        for percent in (2, 5, 10):
            a, b = (expose(image, 2.55 * percent, seed) for seed, image in enumerate((first, second)))
            disparity = dic.correlate(dic.prepare(a, grid, settings), b, settings, reference_frame=0, current_frame=1)
            register_rows(a, b, disparity)
            wall, cpu = time.perf_counter(), time.process_time()
            shifts = register_rows(a, b, disparity)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            truth = (second_rows - first_rows)[shifts.row_px]
            jitter = row_jitter(shifts)
            wave = np.exp(2j * np.pi * 50.0 * 0.1071 * shifts.row_px)
            amplitude = 2.0 * abs(np.mean(shifts.u_px * wave))
            error = np.sqrt(2.0 / shifts.row_px.size) * np.sqrt(np.mean(shifts.sigma_u_px**2))
            segment = np.std(shifts.segment_u_px - truth[:, None])
            sys.stdout.write(
                f"{name:34s} noise {percent:2d} %: error sd u {np.std(shifts.u_px - truth):.4f} v {np.std(shifts.v_px):.4f} px, "
                f"stated {np.sqrt(np.mean(shifts.sigma_u_px**2)):.4f} {np.sqrt(np.mean(shifts.sigma_v_px**2)):.4f}, "
                f"segment {segment:.4f} stated {np.sqrt(np.mean(shifts.segment_sigma_u_px**2)):.4f}, "
                f"jitter {jitter.sd_u_px:.4f} +- {jitter.sigma_u_px:.4f}, "
                f"hum {amplitude:.4f} +- {error:.4f} ({amplitude / error:.0f} sigma), "
                f"noise {shifts.noise_grey:.2f} grey, {wall:.3f} s wall {cpu:.3f} s cpu\n"
            )


if __name__ == "__main__":
    main()
