"""A global drift model fails, a local one fits, and neither gives the reason: the effect that the local one absorbs is named.

    python tests/benchmarks/bench_swallowed.py [--effect magnification_drift] [--peak-px 0.4] [--seed 701]

Sutton et al. (2007) report that one drift for all positions does not fit their pairs, and that a B-spline in time at every position
does. Here an effect of the simulator that is no drift is hidden in an experiment at displacement level, and the same is seen: the
squares of the residual of each model between the two frames of a pair, in smooth shapes and in units of the noise, are 1 where it fits.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

sys.path.insert(0, str(Path(__file__).parent))

from blind.cases import GRID
from blind.experiment import Conditions
from blind.hiding import DETECTABLE_PX, hidden_effect
from blind.observing import observed

from semlive.data.diagnosis.verdict import Diagnosis
from semlive.data.grid import Grid
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.noise_scale import modes, noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.maps.verdict import diagnose

COEFFICIENTS = 6
"""Of the spline over pairs at every position."""


@dataclass(frozen=True, slots=True)
class Swallowed:
    """What two models of drift leave of one experiment.

    Attributes:
        global_misfit: mean square residual of one drift for all positions between the frames of a pair; 1 is noise.
        local_misfit: the same of a drift of its own at every position.
        between_px: root mean square of what the local model has and the global one has not, px.
    """

    global_misfit: float
    local_misfit: float
    between_px: float


def experiment(name: str, peak_px: float, conditions: Conditions, grid: Grid = GRID) -> Observation:
    """One with an effect hidden in it."""
    return observed(conditions, hidden_effect(name, peak_px, conditions.seed), grid)


def absorbed(observation: Observation) -> Swallowed:
    """Fit both."""
    baseline = noise_scaled_baseline(observation)
    whole = _between(baseline.design.whiten(observation.disparity_px))
    residual = _between(baseline.residual())
    local = _local(whole)
    shapes = _smooth(baseline)
    difference_px = _px(baseline, local - (whole - residual))
    between_px = float(np.sqrt(np.mean((shapes @ (np.linalg.pinv(shapes) @ difference_px)) ** 2)))
    spared = 1.0 - COEFFICIENTS / len(whole)
    return Swallowed(_misfit(baseline, residual), _misfit(baseline, whole - local) / spared, between_px)


def _between(white: NDArray[np.float64]) -> NDArray[np.float64]:
    """(pairs, b, 2) second frame against first, of unit variance."""
    return (white[1::2] - white[::2]) / np.sqrt(2.0)


def _local(whole: NDArray[np.float64]) -> NDArray[np.float64]:
    """A cubic spline over the pairs at every position."""
    pairs = len(whole)
    inner = np.linspace(0.0, pairs - 1.0, COEFFICIENTS - 2)
    basis = BSpline.design_matrix(np.arange(pairs, dtype=np.float64), np.r_[[0.0] * 3, inner, [pairs - 1.0] * 3], 3).toarray()
    flat = whole.reshape(pairs, -1)
    return np.asarray(basis @ np.linalg.lstsq(basis, flat, rcond=None)[0]).reshape(whole.shape)


def _smooth(baseline: HyperparameterGrid) -> NDArray[np.float64]:
    """(b, m) smooth shapes, all but a shift."""
    return modes(baseline.design.observation.geometry).mean(axis=0)[:, 1:]


def _misfit(baseline: HyperparameterGrid, residual: NDArray[np.float64]) -> float:
    white = baseline.design.whiten.inverse @ _smooth(baseline)
    basis = np.linalg.qr(white)[0]
    return float(np.mean((basis.T @ residual) ** 2))


def _px(baseline: HyperparameterGrid, white: NDArray[np.float64]) -> NDArray[np.float64]:
    return baseline.design.whiten.factor @ white * baseline.design.whiten.sigma_px * np.sqrt(2.0)


def summary(name: str, one: Swallowed, found: Diagnosis) -> str:
    """A few lines."""
    names = ", ".join(effect.name for effect in found.effects) or "nothing"
    gap = "" if found.gap is None else f", {100 * found.gap.closure:.0f} % of the gap on held-out pairs closed"
    return (
        f"hidden: {name}\n"
        f"residual of one drift for all positions between the frames of a pair: {one.global_misfit:.2f} times the noise\n"
        f"residual of a spline at every position: {one.local_misfit:.2f} times the noise; {one.between_px:.4f} px rms of it are no drift\n"
        f"diagnosis: {found.outcome.value} {names}{gap}\n"
    )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effect", choices=list(DETECTABLE_PX), default="magnification_drift")
    parser.add_argument("--peak-px", type=float, default=0.4)
    parser.add_argument("--seed", type=int, default=701)
    requests = parser.parse_args()
    observation = experiment(requests.effect, requests.peak_px, Conditions(requests.seed))
    sys.stdout.write(summary(requests.effect, absorbed(observation), diagnose(observation)))


if __name__ == "__main__":
    main()
