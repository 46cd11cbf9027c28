"""The specimen: an elastic sheet, its deformation and its motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict

from semlive_simulators.specimen.history import EMPTY_HISTORY, History


@dataclass(frozen=True, slots=True)
class Specimen:
    """A sheet under tension along image y.

    Attributes:
        youngs_modulus_gpa: E.
        poissons_ratio: nu.
        length_mm: length between the grips, mm.
        area_mm2: cross-section, mm2.
        shift_px_per_n: shift of the field of view, (x, y) in px per N (one grip moves).
        rotation_rad_per_n: rotation, rad per N, positive from x to y.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    youngs_modulus_gpa: float
    poissons_ratio: float
    length_mm: float
    area_mm2: float
    shift_px_per_n: tuple[float, float]
    rotation_rad_per_n: float

    @property
    def stiffness_n_mm(self) -> float:
        """Force per elongation of the sheet between the grips, N/mm."""
        return self.youngs_modulus_gpa * 1e3 * self.area_mm2 / self.length_mm

    def gradient(self, force_n: ArrayLike, yaw_rad: ArrayLike = 0.0) -> NDArray[np.float64]:
        """Displacement gradient du_i/dx_j under a force, (..., 2, 2) for forces (...).

        Uniaxial stress along y: eyy = F / (A E), exx = -nu eyy. The rotation (load and stage yaw) is the skew part, so that
        the symmetric part is exactly the strain.
        """
        force = np.asarray(force_n, dtype=np.float64)
        eyy = force / (self.area_mm2 * self.youngs_modulus_gpa * 1e3)
        rotation = self.rotation_rad_per_n * force + np.asarray(yaw_rad, dtype=np.float64)
        gradient = np.empty((*eyy.shape, 2, 2))
        gradient[..., 0, 0] = -self.poissons_ratio * eyy
        gradient[..., 0, 1] = -rotation
        gradient[..., 1, 0] = rotation
        gradient[..., 1, 1] = eyy
        return gradient

    def shift_px(self, force_n: ArrayLike) -> NDArray[np.float64]:
        """Shift of the centre of the field of view by a force, (..., 2) in px."""
        return np.asarray(force_n, dtype=np.float64)[..., None] * np.asarray(self.shift_px_per_n)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Position and deformation of the specimen, sampled in time and interpolated linearly.

    Without drift and distortion, a material point xi is imaged at xi + shift + gradient (xi - centre), where centre is the centre of the
    frame.

    Attributes:
        time_s: (n,) seconds since the run began, increasing.
        shift_px: (n, 2) displacement of the material point in the centre, px.
        gradient: (n, 2, 2) displacement gradient.
        load_n: (n,) true load, N; None for zero load.
        history: load steps and moves up to the end.
    """

    time_s: NDArray[np.float64]
    shift_px: NDArray[np.float64]
    gradient: NDArray[np.float64]
    load_n: NDArray[np.float64] | None = None
    history: History = EMPTY_HISTORY

    def __post_init__(self) -> None:
        count = self.time_s.size
        if self.load_n is not None and self.load_n.shape != (count,):
            raise ValueError(f"time is {self.time_s.shape}, load {self.load_n.shape}")
        if self.time_s.shape != (count,) or self.shift_px.shape != (count, 2) or self.gradient.shape != (count, 2, 2):
            raise ValueError(f"time is {self.time_s.shape}, shift {self.shift_px.shape}, gradient {self.gradient.shape}")

    def at(self, time_s: NDArray[np.float64]) -> Motion:
        """The motion at other times; constant before the first and after the last sample."""
        shift = np.stack([np.interp(time_s, self.time_s, self.shift_px[:, axis]) for axis in range(2)], axis=-1)
        entries = [np.interp(time_s, self.time_s, self.gradient[:, i, j]) for i in range(2) for j in range(2)]
        return Motion(time_s, shift, np.stack(entries, axis=-1).reshape(-1, 2, 2), self.load_at(time_s), self.history)

    def load_at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """True load at times (...), N."""
        return np.zeros(time_s.shape) if self.load_n is None else np.interp(time_s, self.time_s, self.load_n)


def at_rest(
    shift_px: ArrayLike = (0.0, 0.0),
    gradient: ArrayLike = ((0.0, 0.0), (0.0, 0.0)),
    load_n: float = 0.0,
    history: History = EMPTY_HISTORY,
) -> Motion:
    """A specimen that does not move: shift (2,) in px, displacement gradient (2, 2), under a constant load."""
    shift = np.asarray(shift_px, dtype=np.float64).reshape(1, 2)
    return Motion(np.zeros(1), shift, np.asarray(gradient, dtype=np.float64).reshape(1, 2, 2), np.array([load_n]), history)
