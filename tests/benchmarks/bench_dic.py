"""Speed and accuracy of the DIC engine: ``python tests/benchmarks/bench_dic.py``.

The job: 1024 x 884 px, 8 bit, subset 43, 150 x 120 = 18,000 POI 5 px apart, shift (3.3, -2.7) px plus 1e-3 strain, speckle of
6.7 px, rendered analytically. Prints wall and processor seconds of the best of several runs and errors against the truth.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "dic"))
from speckle import Affine, Speckle, expose

from semlive import dic
from semlive.data.settings import DicSettings
from semlive.dic.coarse import match, smooth_field
from semlive.dic.correlate import solve
from semlive.kernels import cast

RUNS = 7


def best_of(work: Callable[[], object]) -> tuple[float, float]:
    """(wall, processor) seconds of the fastest of RUNS runs."""
    figures = []
    for _ in range(RUNS):
        wall, cpu = time.perf_counter(), time.process_time()
        work()
        figures.append((time.perf_counter() - wall, time.process_time() - cpu))
    return min(figures)


def main() -> None:
    """Run and print."""
    settings = DicSettings()
    start = time.perf_counter()
    dic.warm_up(settings)
    sys.stdout.write(f"warm-up {time.perf_counter() - start:.1f} s, threads {cast.thread_count()}\n")
    speckle = Speckle(1024, 884)
    strain = Affine(u=3.3, v=-2.7, ux=1e-3, vy=-3e-4, uy=2e-4, xc=473.5, yc=398.5)
    images = speckle.render(), speckle.render(strain)
    grid = dic.grid_for(settings, 1024, 884)
    true_u, true_v = strain.at(*grid.mesh())
    for noise in (0.0, 2.0, 5.0, 7.0):
        first, second = (expose(image, noise, seed) for seed, image in enumerate(images))
        prepared = best_of(lambda: dic.prepare(first, grid, settings))  # noqa: B023
        reference = dic.prepare(first, grid, settings)
        pair = best_of(lambda: dic.correlate(reference, second, settings, reference_frame=0, current_frame=1))  # noqa: B023
        m = dic.correlate(reference, second, settings, reference_frame=0, current_frame=1)
        current = cast.grey(second)
        seeding = best_of(lambda: smooth_field(match(reference.coarse, current), grid))  # noqa: B023
        iterations = solve(reference, current, match(reference.coarse, current), settings).iterations.mean()
        ok = m.valid
        du, dv = (m.u_px - true_u)[ok], (m.v_px - true_v)[ok]
        gx = np.gradient(images[0], axis=1)
        sum_x = np.mean(gx**2) * settings.subset_px**2
        floor = np.sqrt(2.0) * max(noise, 12**-0.5) / np.sqrt(sum_x)
        sys.stdout.write(
            f"noise {noise:.0f}: prepare {prepared[0]:.3f} s, correlate {pair[0]:.3f} s wall {pair[1]:.3f} s cpu "
            f"(first guess {seeding[0]:.3f}), "
            f"{iterations:.2f} iterations, converged {ok.sum()}/{ok.size}; bias {du.mean():+.1e} {dv.mean():+.1e}, "
            f"sd {du.std():.2e} {dv.std():.2e}, floor {floor:.2e}, ratio {du.std() / floor:.2f}, predicted/observed "
            f"{np.sqrt(np.mean(m.sigma_u_px[ok] ** 2)) / du.std():.3f} {np.sqrt(np.mean(m.sigma_v_px[ok] ** 2)) / dv.std():.3f}, "
            f"noise estimate {reference.noise_grey:.2f}\n"
        )


if __name__ == "__main__":
    main()
