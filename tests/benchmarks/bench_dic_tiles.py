"""A large pair in bands: ``python tests/benchmarks/bench_dic_tiles.py [edge_px] [step_px]``; time, peak memory, error.

The images are drawn in bands into files and read back as memory maps, so that the peak is the engine's.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive import dic
from semlive.data.settings import DicSettings
from semlive.dic.bands import correlate_tiled

SHIFT = (5, -3)  # integer pixels, so that the truth needs no interpolation
BAND = 1024


def draw(path: Path, edge: int, shift: tuple[int, int], seed: int) -> NDArray[np.uint8]:
    """A speckled frame with 5 grey of noise, as a memory map of uint8."""
    frame = np.memmap(path, dtype=np.uint8, mode="w+", shape=(edge, edge))
    for first in range(0, edge, BAND):
        rows = np.arange(first - 16, min(first + BAND, edge) + 16) - shift[1]
        white = np.stack([np.random.default_rng([7, int(r) + 64]).standard_normal(edge + 64, dtype=np.float32) for r in rows])
        smooth = cv2.GaussianBlur(white, (0, 0), 2.0)[16:-16, 32 - shift[0] : 32 - shift[0] + edge]
        noise = np.random.default_rng([seed, first]).standard_normal(smooth.shape, dtype=np.float32)
        frame[first : first + BAND] = np.clip(128.0 + 276.0 * smooth + 5.0 * noise, 0, 255)
    frame.flush()
    return np.memmap(path, dtype=np.uint8, mode="r", shape=(edge, edge))


def main() -> None:
    """Run and print."""
    edge = int(sys.argv[1]) if len(sys.argv) > 1 else 16384
    step = int(sys.argv[2]) if len(sys.argv) > 2 else 8
    settings = DicSettings(step_px=step, roi_px=None)
    dic.warm_up(settings)
    with tempfile.TemporaryDirectory() as folder:
        first = draw(Path(folder) / "first", edge, (0, 0), 1)
        second = draw(Path(folder) / "second", edge, SHIFT, 2)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        grid = dic.grid_for(settings, edge, edge)
        wall, cpu = time.perf_counter(), time.process_time()
        m = correlate_tiled(first, second, grid, settings)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    error = np.hypot(m.u_px - SHIFT[0], m.v_px - SHIFT[1])[m.valid].max(initial=0.0)
    sys.stdout.write(
        f"{edge} x {edge} px, {m.status.size} points: {wall:.1f} s wall, {cpu:.1f} s cpu, peak {peak:.0f} MB ({before:.0f} before), "
        f"converged {m.valid.mean():.4f}, worst {error:.3f} px\n"
    )


if __name__ == "__main__":
    main()
