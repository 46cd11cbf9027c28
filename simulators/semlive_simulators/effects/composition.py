"""Combination of several effects."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive_simulators.effects.interfaces import (
    Array,
    DeformationEffect,
    DriftEffect,
    Effect,
    ExtensometerEffect,
    HoleEffect,
    Instants,
    IntensityEffect,
    LoadCellEffect,
    NoiseEffect,
    PixelOffsetEffect,
    PixelVisits,
    Plane,
    PlasticityEffect,
    ProbeEffect,
    ScanEffect,
    SpecimenMotionEffect,
    SpeckleEffect,
    TimestampEffect,
    TimingEffect,
)
from semlive_simulators.microscope.patterns import Pattern
from semlive_simulators.microscope.scan import Scan, Timing, timing
from semlive_simulators.specimen.specimen import Motion


@dataclass(frozen=True, slots=True)
class EffectSet:
    """The active effects, none by default; sums are in their order."""

    members: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        names = [member.name for member in self.members]
        if len(set(names)) < len(names):
            raise ValueError(f"an effect is listed twice: {', '.join(names)}")

    @property
    def by_pixel(self) -> bool:
        """Whether an effect must be evaluated at each pixel."""
        return any(
            isinstance(member, PixelOffsetEffect | DeformationEffect | ProbeEffect | IntensityEffect | NoiseEffect)
            for member in self.members
        )

    def timing(self, scan: Scan) -> Timing:
        """True times at which pixels are visited."""
        result = timing(scan)
        for member in self.members:
            if isinstance(member, TimingEffect):
                result = member.retime(result, scan)
        return result

    def deflection(self, at: Instants) -> Array | None:
        """Sum of the deflections, (n, 2, 2); None without any."""
        terms = [member.deflection(at) for member in self.members if isinstance(member, ScanEffect)]
        return np.sum(terms, axis=0) if terms else None

    def drift_px(self, at: Instants) -> Array | None:
        """Sum of the drifts, (n, 2); None without any."""
        terms = [member.drift_px(at) for member in self.members if isinstance(member, DriftEffect)]
        return np.sum(terms, axis=0) if terms else None

    def offset_px(self, at: PixelVisits) -> list[Plane]:
        """The offsets of every effect that has one."""
        return [member.offset_px(at) for member in self.members if isinstance(member, PixelOffsetEffect)]

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> list[Plane]:
        """The deformations of every effect that has one."""
        return [member.material_px(x_px, y_px, at) for member in self.members if isinstance(member, DeformationEffect)]

    def absent(self, x_px: Array, y_px: Array, at: PixelVisits) -> NDArray[np.bool_]:
        """Whether material points do not exist."""
        absent = np.zeros(np.broadcast_shapes(x_px.shape, y_px.shape), dtype=bool)
        for member in self.members:
            if isinstance(member, HoleEffect):
                absent |= member.absent(x_px, y_px, at)
        return absent

    @property
    def deforming(self) -> bool:
        """Whether any effect deforms."""
        return any(isinstance(member, DeformationEffect) for member in self.members)

    def moved(self, at: Instants) -> Motion:
        """The motion of the specimen with all effects at instants (n,)."""
        motion = at.motion.at(at.time_s)
        for member in self.members:
            if isinstance(member, SpecimenMotionEffect):
                shift = motion.shift_px + member.specimen_shift_px(at)
                motion = replace(motion, shift_px=shift, gradient=motion.gradient + member.specimen_gradient(at))
        return motion

    def plastic_strain(self, peak_n: float) -> float:
        """Sum of the plastic strains along y after a highest load so far, N."""
        peak = np.array([peak_n])
        return float(sum(member.plastic_strain(peak)[0] for member in self.members if isinstance(member, PlasticityEffect)))

    def optics(self) -> Optics:
        """The effects on probe, pattern and detector."""
        return Optics(self.members)

    def readings(self) -> SensorEffects:
        """The effects on load cell, extension and clock."""
        return SensorEffects(self.members)


@dataclass(frozen=True, slots=True)
class Optics:
    """The effects on probe, pattern and detector."""

    members: tuple[Effect, ...]

    def probe_px(self, at: Instants) -> Array:
        """(n, 2, 2) lower triangle L of the probe's covariance L L^T."""
        covariance = np.broadcast_to(at.scan.spot_px**2 * np.eye(2), (at.time_s.size, 2, 2))
        for member in self.members:
            if isinstance(member, ProbeEffect):
                covariance = covariance + member.blur_px2(at)
        probe = np.zeros(covariance.shape)
        probe[:, 0, 0] = np.sqrt(covariance[:, 0, 0])
        np.divide(covariance[:, 1, 0], probe[:, 0, 0], out=probe[:, 1, 0], where=probe[:, 0, 0] > 0.0)
        probe[:, 1, 1] = np.sqrt(np.maximum(covariance[:, 1, 1] - probe[:, 1, 0] ** 2, 0.0))
        return probe

    def speckle(self, speckle: Pattern) -> Pattern:
        """The changed pattern."""
        for member in self.members:
            if isinstance(member, SpeckleEffect):
                speckle = member.changed(speckle)
        return speckle

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """Grey levels before noise."""
        for member in self.members:
            if isinstance(member, IntensityEffect):
                grey = member.grey(grey, x_px, y_px, at)
        return grey

    def variance(self, variance: Array, grey: Array) -> Array:
        """Variance of the noise."""
        for member in self.members:
            if isinstance(member, NoiseEffect):
                variance = member.variance(variance, grey)
        return variance


@dataclass(frozen=True, slots=True)
class SensorEffects:
    """The effects on readings of instruments."""

    members: tuple[Effect, ...]

    def load_n(self, reading_n: float, time_s: float, motion: Motion) -> float:
        """The reading of the load cell, N."""
        for member in self.members:
            if isinstance(member, LoadCellEffect):
                reading_n = member.load_reading_n(reading_n, time_s, motion)
        return reading_n

    def extension_mm(self, reading_mm: float, load_n: float) -> float:
        """The reading of the extension, mm."""
        for member in self.members:
            if isinstance(member, ExtensometerEffect):
                reading_mm = member.extension_reading_mm(reading_mm, load_n)
        return reading_mm

    def specimen_strain(self, time_s: float, motion: Motion, scan: Scan) -> float:
        """Strain along y of a gage in addition to elastic and plastic strain."""
        at = Instants(np.array([time_s]), time_s, 0, scan, motion)
        moving = [
            member for member in self.members if isinstance(member, SpecimenMotionEffect) and not isinstance(member, PlasticityEffect)
        ]
        return float(sum(member.specimen_gradient(at)[0, 1, 1] for member in moving))

    def stamp_s(self, true_s: float) -> float:
        """Time on the clock of the microscope, seconds since the run began."""
        for member in self.members:
            if isinstance(member, TimestampEffect):
                true_s = member.stamp_s(true_s)
        return true_s
