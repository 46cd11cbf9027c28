"""Plastic strain: a power law of the highest stress so far, which remains after unloading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, Effect, Instants, Magnification, pick_by_magnification


@dataclass(frozen=True, slots=True)
class PlasticHardening(Effect):
    """Ramberg and Osgood's law (1943): eyy = s / E + 0.002 (s_max / s_02)^n, the second part at constant volume.

    The elastic part is that of the specimen. Crosshead and strain gage measure the plastic part as well.

    Attributes:
        area_mm2: cross-section, to convert loads to stresses.
        proof_stress_mpa: s_02, the stress at a plastic strain of 0.2 %.
        exponent: n.
    """

    name: ClassVar[str] = "plastic_hardening"

    area_mm2: float
    proof_stress_mpa: float
    exponent: float

    def __post_init__(self) -> None:
        if not (self.area_mm2 > 0 and self.proof_stress_mpa > 0 and self.exponent >= 1):
            raise ValueError("area_mm2 and proof_stress_mpa must be above 0, exponent at least 1")

    @classmethod
    def defaults(cls, magnification: Magnification) -> PlasticHardening:
        """AL2024 annealed, 10 mm^2: 0.2 % plastic at 95 MPa, 1.3 % at 2200 N."""
        return cls(pick_by_magnification(magnification, 10.0, 10.0), 95.0, 2.25)

    def plastic_strain(self, peak_n: Array) -> Array:
        """Plastic strain along y after highest loads (n,) so far, N."""
        stress_mpa = np.maximum(peak_n, 0.0) / self.area_mm2
        return 0.002 * (stress_mpa / self.proof_stress_mpa) ** self.exponent

    def specimen_shift_px(self, at: Instants) -> Array:
        """Zero: the centre does not move."""
        return np.zeros((at.time_s.size, 2))

    def specimen_gradient(self, at: Instants) -> Array:
        """Plastic strain along y, and minus half of it along x."""
        strain = self.plastic_strain(_peak_n(at))
        gradient = np.zeros((at.time_s.size, 2, 2))
        gradient[:, 0, 0], gradient[:, 1, 1] = -0.5 * strain, strain
        return gradient


def _peak_n(at: Instants) -> Array:
    """Highest load up to each instant, N, of all completed load steps and of the present load."""
    peak, level = at.motion.load_at(at.time_s), 0.0
    for step in at.motion.history.load_steps:
        level += step.change_n
        peak = np.where(at.time_s >= step.time_s, np.maximum(peak, level), peak)
    return peak
