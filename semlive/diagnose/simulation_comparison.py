"""Comparison of a measurement with simulations without and with the identified effects: reduction of the misfit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.noise_scale import modes, noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.residual_channels import ChannelResidual, compared_channels
from semlive.errors import BadInput

Array = NDArray[np.float64]
BOOTSTRAP_DRAWS = 999
MIN_BEYOND_NOISE_FRACTION = 0.5


@dataclass(frozen=True, slots=True)
class MisfitReduction:
    """Misfit without and with effects, noise floor, and explained fraction with its 95 % interval."""

    before_px: float
    after_px: float
    floor_px: float
    closure: float
    interval: tuple[float, float]

    @property
    def is_reduced(self) -> bool:
        """Whether more than half of the misfit is explained, significantly."""
        return self.closure > 0.5 and self.interval[0] > 0.0


@dataclass(frozen=True, slots=True)
class SmoothPowerRatio:
    """Smooth residual power beyond noise: measured, simulated, and their ratio with its 95 % interval."""

    measured_px: float
    simulated_px: float
    ratio: float
    interval: tuple[float, float]

    @property
    def agrees(self) -> bool:
        """Whether the measurement has a smooth residual and the simulation has the same power within a factor of two."""
        return self.measured_px > 0.0 and 0.5 < self.ratio < 2.0


@dataclass(frozen=True, slots=True)
class Comparison:
    """Comparison of simulation and measurement. Intervals are bootstrap intervals over pairs.

    Attributes:
        maps: misfit between measured and simulated maps, both without the part explained by the baseline.
        sizes: sizes of effects that are random in every frame or step; a simulation reproduces their size but not their time course.
        frames: number of compared frames.
        blocks: number of point blocks in each.
        channels: the misfit by channel, in units of the noise.
    """

    maps: MisfitReduction
    sizes: SmoothPowerRatio
    frames: int
    blocks: int
    channels: tuple[ChannelResidual, ...]

    @property
    def confirmed(self) -> bool:
        """Whether the simulation with the effects is closer to the measurement, or random effects have the same size."""
        return self.maps.is_reduced or self.sizes.agrees


@dataclass(frozen=True, slots=True)
class Proof:
    """Result of the confirmation of a diagnosis.

    Attributes:
        pairs: number of pairs of the measured run, and of each simulated one.
        channels: the gap by channel: measured minus simulated maps, or the residual of the measured maps if nothing was simulated.
        added: names of the effects that were added; empty if nothing was simulated.
        comparison: comparison with both simulations; None if nothing was simulated.
        reason: why nothing was added, a clause; empty otherwise.
    """

    pairs: int
    channels: tuple[ChannelResidual, ...]
    added: tuple[str, ...] = ()
    comparison: Comparison | None = None
    reason: str = ""


def compare_with_simulations(measured: Observation, without: Observation, with_effects: Observation) -> Comparison:
    """Compare root mean squares of block means.

    The residual of the simulation without effects contains only noise, so it determines the noise floor.

    Args:
        measured: the run in which the effects were identified.
        without: simulation of the same experiment without them.
        with_effects: simulation with them.

    Raises:
        BadInput: the runs differ in frames or grid.
    """
    runs = (measured, without, with_effects)
    if len({(run.frames, run.grid) for run in runs}) > 1:
        text = ", ".join(f"{run.frames} frames of {run.grid.nx} x {run.grid.ny} points" for run in runs)
        raise BadInput(f"the runs cannot be compared frame by frame: {text}; simulate the scenario with the protocol of the measured run")
    blocks = reduce(np.intersect1d, [run.valid_blocks for run in runs])
    baselines = [noise_scaled_baseline(run) for run in runs]
    residual = [_residual_px(baseline)[:, np.isin(baseline.design.observation.valid_blocks, blocks)] for baseline in baselines]
    noise_px = [baseline.design.whiten.sigma_px for baseline in baselines[:2]]
    noise_ratio = (noise_px[0] / noise_px[1]) ** 2
    gaps = (residual[0] - residual[1], residual[0] - residual[2])
    maps = _maps(np.stack([*(_squares(gap) for gap in gaps), (1.0 + noise_ratio) * _squares(residual[1])]))
    common = np.isin(measured.valid_blocks, blocks)
    shapes = np.linalg.qr(modes(measured.geometry)[:, common].mean(axis=0))[0]
    smooth = [_squares(np.einsum("bk,ck,fcd->fbd", shapes, shapes, value, optimize=True)) for value in residual]
    channels = compared_channels(measured.geometry, common, residual, noise_px)
    return Comparison(maps, _sizes(smooth, noise_ratio), len(residual[0]), len(blocks), channels)


def _residual_px(run: HyperparameterGrid) -> Array:
    """(f, b, 2) residual of the baseline in every frame, px; the mean over the frames is not determined.

    The residual of the first solution is not used: it may include raster terms, which removed a magnification drift of 0.4 px.
    """
    whiten = run.design.whiten
    return np.asarray(whiten.sigma_px * np.matmul(whiten.factor, run.residual()))


def _squares(field_px: Array) -> Array:
    """(pairs,) mean squares."""
    return np.asarray((np.mean(field_px**2, axis=(1, 2)) * 2.0).reshape(-1, 2).mean(axis=1))


def _bootstrap_means(by_pair: Array) -> Array:
    """(k, draws) bootstrap means over resampled pairs, of (k, pairs)."""
    n = by_pair.shape[1]
    return np.asarray(by_pair[:, np.random.default_rng(0).integers(n, size=(BOOTSTRAP_DRAWS, n))].mean(axis=2))


def _interval(samples: Array) -> tuple[float, float]:
    low, high = np.quantile(samples, (0.025, 0.975)).tolist()
    return low, high


def _maps(by_pair: Array) -> MisfitReduction:
    before, after, floor = np.sqrt(by_pair.mean(axis=1)).tolist()
    return MisfitReduction(before, after, floor, float(_closure(by_pair.mean(axis=1))), _interval(_closure(_bootstrap_means(by_pair))))


def _closure(squares: Array) -> Array:
    """Explained fraction; 0 without a misfit."""
    gap = squares[0] - squares[2]
    return np.where(gap > 0.0, (squares[0] - squares[1]) / np.where(gap > 0.0, gap, 1.0), 0.0)


def _sizes(smooth: list[Array], noise_ratio: float) -> SmoothPowerRatio:
    """Power of the measurement and of the simulation with effects beyond the simulation without effects, scaled by the noise."""
    beyond = np.stack([smooth[0] - noise_ratio * smooth[1], smooth[2] - smooth[1]])
    measured, simulated = np.sqrt(np.maximum(beyond.mean(axis=1), 0.0)).tolist()
    samples = np.maximum(_bootstrap_means(beyond), 0.0)
    # The baseline absorbs noise differently in each run, by up to a fifth, because each run determines its own smoothness.
    observed = float(np.quantile(samples[0], 0.025)) > MIN_BEYOND_NOISE_FRACTION * noise_ratio * float(smooth[1].mean())
    ratios = np.sqrt(samples[1] / np.maximum(samples[0], 1e-30))
    ratio = simulated / measured if observed else 0.0
    return SmoothPowerRatio(measured if observed else 0.0, simulated, ratio, _interval(ratios) if observed else (0.0, math.inf))
