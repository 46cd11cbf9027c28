"""Hidden effects that keep their name and not quite their law: nature has not read the dictionary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from semlive_simulators.effects.charging import ChargingLocalLens
from semlive_simulators.effects.drift import ThermalOscillation
from semlive_simulators.effects.image_field import (
    AspectDrift,
    DistortionScaleDrift,
    MagnificationDrift,
    RasterRotationDrift,
    ScanShearDrift,
)
from semlive_simulators.effects.interfaces import Array, Effect, Instants, PixelVisits, Plane
from semlive_simulators.effects.specimen_motion import CreepInHold, LoadStepTransient, StageStepTransient

STRETCH = 0.7
"""exp(-(T / tau)^0.7) in place of exp(-T / tau)."""
OVERTONE, LAG_RAD = 0.15, 0.9
LATER_SHARE, LATER_S = 0.3, 200.0
T = TypeVar("T", Instants, PixelVisits)


def stretched_s(time_s: Array, tau_s: float) -> Array:
    """The time at which the exponential is what the stretched one is at another."""
    return np.asarray(tau_s * (np.maximum(time_s, 0.0) / tau_s) ** STRETCH)


def _later(at: T, tau_s: float) -> T:
    return replace(at, time_s=stretched_s(at.time_s, tau_s))


class _Magnification(MagnificationDrift):
    def deflection(self, at: Instants) -> Array:
        return MagnificationDrift.deflection(self, _later(at, self.time_constant_s))


class _Rotation(RasterRotationDrift):
    def deflection(self, at: Instants) -> Array:
        return RasterRotationDrift.deflection(self, _later(at, self.time_constant_s))


class _Aspect(AspectDrift):
    def deflection(self, at: Instants) -> Array:
        return AspectDrift.deflection(self, _later(at, self.time_constant_s))


class _Shear(ScanShearDrift):
    def deflection(self, at: Instants) -> Array:
        return ScanShearDrift.deflection(self, _later(at, self.time_constant_s))


class _DistortionScale(DistortionScaleDrift):
    def offset_px(self, at: PixelVisits) -> Plane:
        return DistortionScaleDrift.offset_px(self, _later(at, self.time_constant_s))


class _Lens(ChargingLocalLens):
    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        return ChargingLocalLens.material_px(self, x_px, y_px, _later(at, self.charging_s))


class _Oscillation(ThermalOscillation):
    def drift_px(self, at: Instants) -> Array:
        turn = 2.0 * np.pi * at.time_s / self.period_s + self.phase_rad
        wave = np.sin(turn) + OVERTONE * np.sin(2.0 * turn + LAG_RAD)
        return np.asarray(wave[:, None] * np.array([self.x_px, self.y_px]))


class _Creep(CreepInHold):
    def specimen_gradient(self, at: Instants) -> Array:
        """A Kelvin element in addition to the logarithm."""
        more = np.zeros(at.time_s.size)
        for step in at.motion.history.load_steps:
            slow = -np.expm1(-np.maximum(at.time_s - step.time_s, 0.0) / LATER_S)
            more = np.where(at.time_s >= step.time_s, LATER_SHARE * self.strain_per_n * at.motion.load_at(at.time_s) * slow, more)
        shape = np.array([[-self.poissons_ratio, 0.0], [0.0, 1.0]])
        return np.asarray(CreepInHold.specimen_gradient(self, at) + more[:, None, None] * shape)


class _LoadTransient(LoadStepTransient):
    def drift_px(self, at: Instants) -> Array:
        total = np.zeros(at.time_s.size)
        for step in at.motion.history.load_steps:
            total += np.where(at.time_s >= step.time_s, step.change_n * self._left(at.time_s - step.time_s), 0.0)
        return np.asarray(total[:, None] * np.array([self.x_px_per_n, self.y_px_per_n]))

    def _left(self, elapsed_s: Array) -> Array:
        return np.exp(-stretched_s(elapsed_s, self.time_constant_s) / self.time_constant_s)


class _StageTransient(StageStepTransient):
    def drift_px(self, at: Instants) -> Array:
        total = np.zeros((at.time_s.size, 2))
        for move in at.motion.history.moves:
            late_s = stretched_s(at.time_s - move.time_s, self.time_constant_s)
            left = np.where(at.time_s >= move.time_s, self.fraction * np.exp(-late_s / self.time_constant_s), 0.0)
            total += left[:, None] * np.array(move.change_px)
        return total


_KINDS: tuple[Callable[..., Effect], ...] = (
    _Magnification, _Rotation, _Aspect, _Shear, _DistortionScale, _Lens, _Oscillation, _Creep, _LoadTransient, _StageTransient,
)  # fmt: skip
_BY_NAME: dict[str, Any] = {kind.name: kind for kind in _KINDS}  # type: ignore[attr-defined]
DEFORMED: tuple[str, ...] = tuple(_BY_NAME)
"""Names that come with another law too."""


def deformed(effect: Effect) -> Effect:
    """The same effect with another law of time."""
    values = {item.name: getattr(effect, item.name) for item in fields(effect)}  # pyright: ignore[reportArgumentType]
    return _BY_NAME[effect.name](**values)
