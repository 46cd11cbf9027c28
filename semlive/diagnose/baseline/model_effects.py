"""Effects given by the user: they are added to the baseline, and their displacement can be subtracted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from semlive.data.diagnosis.effects import ModelEffect
from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.diagnose.baseline.baseline import HyperparameterGrid, build_grid
from semlive.diagnose.baseline.design_matrix import BaselineEffect
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.baseline.strain_attenuation import MAX_ATTENUATION, strain_attenuation
from semlive.errors import BadInput
from semlive.model.effects import EFFECT_CLASSES, EffectClass

Array = NDArray[np.float64]


def effect_class(name: str) -> EffectClass:
    """Effect class by name.

    Raises:
        BadInput: no class has this name.
    """
    family = next((family for family in EFFECT_CLASSES if family.name == name), None)
    if family is None:
        raise BadInput(f"model: no effect is called {name}; the dictionary contains {', '.join(family.name for family in EFFECT_CLASSES)}.")
    return family


def observable_effects(observation: Observation, model_effects: Sequence[ModelEffect]) -> list[ModelEffect]:
    """Effects observable in a run; some require loads or stage moves."""
    return [
        model_effect
        for model_effect in model_effects
        if effect_class(model_effect.name).basis_field(observation.geometry, dict(model_effect.values)) is not None
    ]


def add_model_effects(baseline: HyperparameterGrid, model_effects: Sequence[ModelEffect]) -> tuple[HyperparameterGrid, tuple[Array, ...]]:
    """Add effects to the baseline with free amplitudes. Returns the grid and (f, b, 2, q) displacement of unit amplitudes of each, px.

    Raises:
        BadInput: an effect is unknown or not observable in these data.
    """
    columns, fields = baseline.design, []
    for model_effect in model_effects:
        basis_field = effect_class(model_effect.name).basis_field(columns.observation.geometry, dict(model_effect.values))
        if basis_field is None:
            raise BadInput(f"model: {model_effect.name} is not observable in this run, which has no loads or moves; use another model.")
        columns = columns.with_effects(BaselineEffect(columns.whiten(basis_field.field_px), model_effect.size_px))
        fields.append(basis_field.field_px)
    return (build_grid(columns) if model_effects else baseline), tuple(fields)


def fitted_amplitudes(baseline_with_effects: HyperparameterGrid) -> Array:
    """(r,) most likely amplitudes of the effects in a baseline at its most likely smoothness."""
    return np.asarray(
        baseline_with_effects.best.solve(baseline_with_effects.best.gradient[:, None])[
            len(baseline_with_effects.design.parameter_indices) :, 0
        ]
    )


@dataclass(frozen=True, slots=True, eq=False)
class EffectDisplacement:
    """Displacement caused by effects.

    Attributes:
        effects: names of the effects.
        field_px: (f, b, 2) total displacement since frame 0, px.
        not_corrected: names of effects that are strain, resemble strain, or would remove more than 2 % of a strain; not part of the field.
        baseline_with_effects: the fit of all of them.
    """

    effects: tuple[str, ...]
    field_px: Array
    not_corrected: tuple[str, ...]
    baseline_with_effects: HyperparameterGrid


def effect_displacement(observation: Observation, model_effects: Sequence[ModelEffect]) -> EffectDisplacement:
    """Displacement by effects, with amplitudes refitted jointly with drift, distortion and motion.

    Raises:
        BadInput: an effect is unknown or not observable in these data.
    """
    baseline_with_effects, fields = add_model_effects(noise_scaled_baseline(observation), model_effects)
    amplitudes = fitted_amplitudes(baseline_with_effects)
    total, first = np.zeros((observation.frames, observation.blocks, 2)), 0
    not_corrected = []
    for model_effect, field, attenuation in zip(
        model_effects, fields, strain_attenuation(baseline_with_effects, fields, len(fields)), strict=True
    ):
        if effect_class(model_effect.name).strain_like or attenuation > MAX_ATTENUATION:
            not_corrected.append(model_effect.name)
        else:
            total += field @ amplitudes[first : first + field.shape[-1]]
        first += field.shape[-1]
    names = tuple(model_effect.name for model_effect in model_effects)
    return EffectDisplacement(names, total - total[0], tuple(not_corrected), baseline_with_effects)


def interpolate_to_grid(observation: Observation, moved: Array, grid: Grid) -> dict[int, Array]:
    """Interpolate the displacement of effects from blocks (f, b, 2) to all points: (ny, nx, 2) by frame number.

    The smoothest interpolating surface is used. Effects are smooth over a subset, because correlation does not resolve shorter waves.
    """
    scene = observation.geometry
    place = scene.address_px[0] + observation.state.centre_px
    points = np.stack(grid.mesh(), axis=-1).reshape(-1, 2)
    values = np.moveaxis(moved, 0, 1).reshape(len(place), -1)
    interpolated = RBFInterpolator(place, values, kernel="thin_plate_spline", degree=1)(points)
    fields = interpolated.reshape(*grid.shape, len(scene.frame), 2)
    return {int(frame): fields[:, :, at] for at, frame in enumerate(scene.frame)}


def subtract_effects(disparity: DisparityMap, by_frame: Mapping[int, Array]) -> DisparityMap:
    """A map minus the displacement (ny, nx, 2) px of its frames, by frame number; unchanged for frames without displacement."""
    if not by_frame:
        return disparity
    by = by_frame[disparity.current] - by_frame[disparity.reference]
    u, v = (value.copy() for value in (disparity.u_px, disparity.v_px))
    u[disparity.valid] -= by[..., 0][disparity.valid]
    v[disparity.valid] -= by[..., 1][disparity.valid]
    return replace(disparity, u_px=u, v_px=v)
