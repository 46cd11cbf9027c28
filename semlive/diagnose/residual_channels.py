"""Residual of the maps by channel in units of the noise: displacement along x and y, all of it and its smooth part."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import ModelEffect
from semlive.data.strain import MeasuredValue
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.model_effects import add_model_effects, observable_effects
from semlive.diagnose.baseline.noise_scale import modes, noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.model.effects import RunGeometry
from semlive.model.effects.stage import non_map_effect

Array = NDArray[np.float64]
BOOTSTRAP_DRAWS = 999
AXES = ("x", "y")


@dataclass(frozen=True, slots=True)
class ChannelResidual:
    """Root mean square residual in one channel, in standard deviations of the noise, with standard uncertainties.

    Attributes:
        channel: ``x`` or ``y``: block means of the displacement along it; ``x_smooth`` or ``y_smooth``: coefficients of the polynomials in
            each frame, in which an effect is large relative to the noise.
        before: without the effects.
        after: with the effects; None if none was added.
        expected: residual by noise alone.
    """

    channel: str
    before: MeasuredValue
    after: MeasuredValue | None
    expected: MeasuredValue


def channel_transforms(scene: RunGeometry, blocks: NDArray[np.bool_] | None = None) -> tuple[tuple[str, Array], ...]:
    """Suffix of the channels, and (k, b) transform of block means into the numbers of the channel; its rows have unit length.

    Args:
        scene: geometry of the run.
        blocks: (b,) blocks to use; None for all.
    """
    fields = modes(scene).mean(axis=0)
    shapes = np.linalg.qr(fields if blocks is None else fields[blocks])[0]
    return ("", np.eye(len(shapes))), ("_smooth", shapes.T)


def compared_channels(
    scene: RunGeometry, blocks: NDArray[np.bool_], residuals_px: Sequence[Array], noise_px: Sequence[float]
) -> tuple[ChannelResidual, ...]:
    """Channels of measured minus simulated maps.

    Args:
        scene: geometry of the measured run.
        blocks: (b',) which of its blocks the residuals contain.
        residuals_px: (f, b, 2) residual of the baseline of the measured run, and of its simulations without and with the effects, px.
        noise_px: standard deviation of a block mean in the measured run and in the simulation without the effects, px.
    """
    measured, without, with_effects = residuals_px
    own, simulated = noise_px
    unit_px = float(np.hypot(own, simulated))
    fields = (measured - without) / unit_px, (measured - with_effects) / unit_px, without / simulated
    channels = []
    for name, by_pair in _squares(channel_transforms(scene, blocks), fields):
        before, after, expected = map(_root_mean, by_pair)
        channels.append(ChannelResidual(name, before, after, expected))
    return tuple(channels)


def measured_channels(observation: Observation, model_effects: Sequence[ModelEffect] = ()) -> tuple[ChannelResidual, ...]:
    """Channels of a run without further effects, and the residual of noise alone after the fit of the baseline.

    Args:
        observation: observation of a run.
        model_effects: effects of the model of the run; those that the maps do not show are ignored.
    """
    in_maps = observable_effects(observation, [effect for effect in model_effects if non_map_effect(effect.name) is None])
    baseline = add_model_effects(noise_scaled_baseline(observation), in_maps)[0]
    factor = baseline.design.whiten.factor
    residual = np.asarray(np.matmul(factor, baseline.residual()))
    transforms = channel_transforms(observation.geometry)
    expected = [_expected(baseline, axis, transform @ factor) for _, transform in transforms for axis in (0, 1)]
    found = _squares(transforms, (residual,))
    return tuple(ChannelResidual(name, _root_mean(by_pair[0]), None, noise) for (name, by_pair), noise in zip(found, expected, strict=True))


def _squares(transforms: Sequence[tuple[str, Array]], fields: Sequence[Array]) -> Iterator[tuple[str, Array]]:
    """Name of each channel, and (n, pairs) mean squares of n fields (f, b, 2) in it."""
    for suffix, transform in transforms:
        squares = np.stack([np.mean((transform @ field) ** 2, axis=1) for field in fields])  # (n, f, 2)
        for axis, name in enumerate(AXES):
            yield name + suffix, squares[:, :, axis].reshape(len(fields), -1, 2).mean(axis=2)


def _root_mean(squares: Array) -> MeasuredValue:
    """Root mean of mean squares (pairs,), with its bootstrap uncertainty over pairs."""
    samples = squares[np.random.default_rng(0).integers(len(squares), size=(BOOTSTRAP_DRAWS, len(squares)))].mean(axis=1)
    return MeasuredValue(float(np.sqrt(squares.mean())), float(np.sqrt(samples).std()))


def _expected(baseline: HyperparameterGrid, axis: int, transform: Array) -> MeasuredValue:
    """Root mean square residual of unit noise along one axis after the fit, with its standard deviation over runs.

    Args:
        baseline: the fitted baseline.
        axis: 0 for x, 1 for y.
        transform: (k, b) transform of whitened block means into the numbers of the channel.
    """
    columns = baseline.design
    f, b = columns.observation.frames, columns.observation.blocks
    own = (transform @ columns.columns[axis].reshape(f, b, -1)).reshape(f * len(transform), -1)
    inside = np.zeros((columns.size, own.shape[1]))
    inside[columns.index[axis]] = own.T @ own
    gram = transform @ transform.T
    explained = float(np.trace(baseline.best.solve(inside)[columns.index[axis]]))
    mean = ((f - 1) * float(np.trace(gram)) - explained) / (f * len(transform))
    freedom = (f - 1) * float(np.trace(gram)) ** 2 / float(np.sum(gram**2))
    root = float(np.sqrt(max(mean, 0.0)))
    return MeasuredValue(root, root / float(np.sqrt(2.0 * freedom)))
