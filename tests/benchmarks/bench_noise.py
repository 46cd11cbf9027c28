"""Displacement noise that the scenarios' detectors make: ``python tests/benchmarks/bench_noise.py``.

Subsets of 43 px, one pair as the experiment takes it (second frame right after the first, drift included), correlated for several
draws of the detector's noise: what differs between draws is noise. The goal is 0.025 px at x200 and 0.05 px at x10,000.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive import dic
from semlive.data.settings import DicSettings
from semlive_simulators.microscope.column import Column
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.specimen import at_rest

STARTS_S = {"paper_x200": (0.0, 2500.0, 5000.0), "paper_x10000": (0.0, 1000.0, 2200.0, 4200.0), "short": (0.0,)}
DRAWS = 4


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of one pair's displacement, px, over independent subsets; and what correlation itself expects."""

    u_px: float
    v_px: float
    predicted_px: float
    points: int


def signal_of(column: Column, start_s: float) -> NDArray[np.float64]:
    """What a frame is before its noise: the sum of its visits."""
    signal = np.zeros((column.scan.height_px, column.scan.width_px))
    for visit in range(column.visits):
        column.expose(signal, 0, visit, start_s, at_rest(), 0)
    return signal


def digitised(column: Column, signal: NDArray[np.float64], frame: int) -> NDArray[np.unsignedinteger]:
    """A frame with the noise of its number."""
    image = np.empty(signal.shape, dtype=column.detector.dtype)
    column.digitise(image, 0, signal, frame)
    return image


def noise_of_pair(name: str, start_s: float, draws: int = DRAWS, spacing_px: int = 44) -> Noise:
    """Noise of a pair that begins at `start_s`, seconds since the run began."""
    scenario = load_scenario(name)
    settings, column = DicSettings(step_px=spacing_px), scenario.column()
    second_s = start_s + scenario.scan.duration_s + scenario.scan.gap_s
    grid = dic.grid_for(settings, scenario.scan.width_px, scenario.scan.height_px)
    signals = [signal_of(column, start) for start in (start_s, second_s)]
    maps = []
    for draw in range(draws):
        first, second = (digitised(column, signal, 2 * draw + number) for number, signal in enumerate(signals))
        reference = dic.prepare(first, grid, settings)
        maps.append(dic.correlate(reference, second, settings, reference_frame=0, current_frame=1))
    valid = np.all([item.valid for item in maps], axis=0)
    u_px, v_px = (np.array([getattr(item, part)[valid] for item in maps]) for part in ("u_px", "v_px"))
    sigma = np.array([(item.sigma_u_px[valid] ** 2 + item.sigma_v_px[valid] ** 2) / 2 for item in maps])
    spread = [float(np.sqrt(part.var(axis=0, ddof=1).mean())) for part in (u_px, v_px)]
    return Noise(spread[0], spread[1], float(np.sqrt(sigma.mean())), int(valid.sum()))


def main(names: list[str]) -> None:
    """Print a table."""
    for name in names or list(STARTS_S):
        for start_s in STARTS_S[name]:
            found = noise_of_pair(name, start_s)
            spread = f"u {found.u_px:.4f}  v {found.v_px:.4f}  expected {found.predicted_px:.4f} px"
            sys.stdout.write(f"{name:13} {start_s:6.0f} s  {spread}  {found.points} points\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
