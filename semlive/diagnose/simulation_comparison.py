"""A measurement against simulations of it, without and with the effects that were found: does the gap between them shrink?"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.noise_scale import modes, noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.errors import BadInput

Array = NDArray[np.float64]
RESAMPLED = 999
MIN_BEYOND_NOISE_FRACTION = 0.5


@dataclass(frozen=True, slots=True)
class MisfitReduction:
    """A gap without and with effects, what noise leaves of it, and the share that they close with its 95 % interval."""

    before_px: float
    after_px: float
    floor_px: float
    closure: float
    interval: tuple[float, float]

    @property
    def is_reduced(self) -> bool:
        """Whether more than half of the gap is closed, and not by chance."""
        return self.closure > 0.5 and self.interval[0] > 0.0


@dataclass(frozen=True, slots=True)
class SmoothPowerRatio:
    """How much more than noise is left that is smooth over the field: measured, simulated, and their ratio with its 95 % interval."""

    measured_px: float
    simulated_px: float
    ratio: float
    interval: tuple[float, float]

    @property
    def agrees(self) -> bool:
        """Whether something is left of the measurement, and the simulation has as much of it within a factor of two."""
        return self.measured_px > 0.0 and 0.5 < self.ratio < 2.0


@dataclass(frozen=True, slots=True)
class Comparison:
    """What a simulation says of a model that was found. Intervals are those of pairs drawn again.

    Attributes:
        maps: measured less simulated maps, what the baseline explains of either taken off.
        sizes: of an effect that is anew in every frame or move a simulation has the size and not the course.
        frames: that were compared.
        blocks: of points in each.
    """

    maps: MisfitReduction
    sizes: SmoothPowerRatio
    frames: int
    blocks: int

    @property
    def confirmed(self) -> bool:
        """Whether the simulation with the effects is nearer to the measurement, or what cannot be foretold has the same size."""
        return self.maps.is_reduced or self.sizes.agrees


def compare_with_simulations(measured: Observation, without: Observation, with_effects: Observation) -> Comparison:
    """Compare root mean squares of block means.

    The simulation without effects has nothing but noise in what the baseline leaves of it, so it tells how much that is.

    Args:
        measured: the run that effects were found in.
        without: the same experiment, simulated without them.
        with_effects: simulated with them.

    Raises:
        BadInput: the runs have not the same frames, or not the same grid.
    """
    runs = (measured, without, with_effects)
    if len({(run.frames, run.grid) for run in runs}) > 1:
        text = ", ".join(f"{run.frames} frames of {run.grid.nx} x {run.grid.ny} points" for run in runs)
        raise BadInput(f"the runs cannot be compared frame by frame: {text}; simulate the scenario of the measured run's own protocol")
    blocks = reduce(np.intersect1d, [run.valid_blocks for run in runs])
    baselines = [noise_scaled_baseline(run) for run in runs]
    residual = [_left(baseline)[:, np.isin(baseline.design.observation.valid_blocks, blocks)] for baseline in baselines]
    noisier = (baselines[0].design.whiten.sigma_px / baselines[1].design.whiten.sigma_px) ** 2
    gaps = (residual[0] - residual[1], residual[0] - residual[2])
    maps = _maps(np.stack([*(_squares(gap) for gap in gaps), (1.0 + noisier) * _squares(residual[1])]))
    shapes = np.linalg.qr(modes(measured.geometry)[:, np.isin(measured.valid_blocks, blocks)].mean(axis=0))[0]
    smooth = [_squares(np.einsum("bk,ck,fcd->fbd", shapes, shapes, value, optimize=True)) for value in residual]
    return Comparison(maps, _sizes(smooth, noisier), len(residual[0]), len(blocks))


def _left(run: HyperparameterGrid) -> Array:
    """(f, b, 2) px that the baseline leaves of every frame, their mean over the frames being nobody's.

    Not what the first solution leaves: that may have turned or stretched the raster, and a magnification that drifts by 0.4 px was gone.
    """
    whiten = run.design.whiten
    return np.asarray(whiten.sigma_px * np.matmul(whiten.factor, run.residual()))


def _squares(field_px: Array) -> Array:
    """(pairs,) mean squares."""
    return np.asarray((np.mean(field_px**2, axis=(1, 2)) * 2.0).reshape(-1, 2).mean(axis=1))


def _again(by_pair: Array) -> Array:
    """(k, draws) means over pairs drawn again, of (k, pairs)."""
    n = by_pair.shape[1]
    return np.asarray(by_pair[:, np.random.default_rng(0).integers(n, size=(RESAMPLED, n))].mean(axis=2))


def _interval(samples: Array) -> tuple[float, float]:
    low, high = np.quantile(samples, (0.025, 0.975)).tolist()
    return low, high


def _maps(by_pair: Array) -> MisfitReduction:
    before, after, floor = np.sqrt(by_pair.mean(axis=1)).tolist()
    return MisfitReduction(before, after, floor, float(_closure(by_pair.mean(axis=1))), _interval(_closure(_again(by_pair))))


def _closure(squares: Array) -> Array:
    """Nothing is closed where there is no gap."""
    gap = squares[0] - squares[2]
    return np.where(gap > 0.0, (squares[0] - squares[1]) / np.where(gap > 0.0, gap, 1.0), 0.0)


def _sizes(smooth: list[Array], noisier: float) -> SmoothPowerRatio:
    """By how much the measurement and the simulation with effects exceed the simulation without, noise being scaled."""
    beyond = np.stack([smooth[0] - noisier * smooth[1], smooth[2] - smooth[1]])
    measured, simulated = np.sqrt(np.maximum(beyond.mean(axis=1), 0.0)).tolist()
    samples = np.maximum(_again(beyond), 0.0)
    # What the baseline leaves of noise differs by a fifth between runs: drift and distortion are as smooth as each run says.
    observed = float(np.quantile(samples[0], 0.025)) > MIN_BEYOND_NOISE_FRACTION * noisier * float(smooth[1].mean())
    ratios = np.sqrt(samples[1] / np.maximum(samples[0], 1e-30))
    ratio = simulated / measured if observed else 0.0
    return SmoothPowerRatio(measured if observed else 0.0, simulated, ratio, _interval(ratios) if observed else (0.0, math.inf))
