"""Attenuation of strain by the correction of an effect, measured with injected strain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.model.effects import RunGeometry
from semlive.model.effects.run_geometry import field_column

Array = NDArray[np.float64]
MAX_ATTENUATION = 0.02
"""Largest fraction of an injected strain that a correction may remove."""


def strain_attenuation(baseline_with_effects: HyperparameterGrid, fields: tuple[Array, ...], effect_count: int) -> tuple[float, ...]:
    """Largest fraction of an injected strain removed by the correction of each effect; 0 without a tension phase.

    Each strain component is added separately to all frames under load. The fitted amplitudes change linearly, so noise does not contribute.

    Args:
        baseline_with_effects: the baseline with the effects.
        fields: for each effect, (f, b, 2, q) displacement of unit amplitudes, px.
        effect_count: number of effects given before the search.
    """
    scene, columns = baseline_with_effects.design.observation.geometry, baseline_with_effects.design
    if not scene.steps.loaded.any():
        return tuple(0.0 for _ in fields)
    injected = np.concatenate(_injected(scene), axis=-1)
    first = len(columns.parameter_indices)
    gradient = baseline_with_effects.best.solve(columns.transposed(columns.whiten(injected)))[first:]
    attenuations = []
    for field, own in zip(fields, columns.effect_columns(fields, effect_count), strict=True):
        absorbed = np.einsum("fbcq,qk->fbck", field, gradient[own])
        attenuations.append(max(abs(_strain(scene, absorbed[..., k])[k]) for k in range(injected.shape[-1])))
    return tuple(attenuations)


def _injected(scene: RunGeometry) -> tuple[Array, ...]:
    """(f, b, 2, 1) for exx, eyy and exy: displacement by a strain of 1 / half width in frames under load, px."""
    on = scene.steps.loaded[:, None].astype(np.float64)
    nothing = np.zeros_like(scene.x)
    return field_column(scene.x * on, nothing), field_column(nothing, scene.y * on), field_column(scene.y * on, scene.x * on)


def _strain(scene: RunGeometry, moved: Array) -> tuple[float, float, float]:
    """Mean exx, eyy and exy of frames under load relative to the other frames, in units of the injected strain."""
    strains = []
    for frame in range(len(scene.frame)):
        rows = np.stack((np.ones_like(scene.x[frame]), scene.x[frame], scene.y[frame]), axis=-1)
        _, x, y = np.linalg.lstsq(rows, moved[frame], rcond=None)[0]
        strains.append((x[0], y[1], 0.5 * (x[1] + y[0])))
    each = np.array(strains)
    exx, eyy, exy = each[scene.steps.loaded].mean(axis=0) - each[0]
    return float(exx), float(eyy), float(exy)
