"""Settling of the beam at the start of rows and frames, in time or in position on the specimen, with one or two exponentials."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import Array, ByMagnification, Effect, PixelVisits, Plane


def _decays(amount: Array, first: tuple[float, float], second: tuple[float, float]) -> Array:
    """Sum of two exponential decays, each with (amplitude, constant), over a time or a distance."""
    total = np.zeros_like(amount)
    for amplitude, constant in (first, second):
        if amplitude:
            total += amplitude * np.exp(-amount / constant)
    return total


def _both(amount: Array, amplitudes_x: tuple[float, float], amplitudes_y: tuple[float, float], constants: tuple[float, float]) -> Plane:
    """(u, v) of two exponential decays with common constants."""
    u, v = (_decays(amount, *zip(amplitudes, constants, strict=True)) for amplitudes in (amplitudes_x, amplitudes_y))
    return u, v


def _require_positive(**constants: float) -> None:
    for name, value in constants.items():
        if not value > 0.0:
            raise ValueError(f"{name} must be above 0, not {value}")


@dataclass(frozen=True, slots=True)
class FlybackSettling(Effect):
    """The beam settles at the start of each row: inductance of the coils, slew rate of the amplifier, eddy currents.

    u = A exp(-x t_D / tau) + A2 exp(-x t_D / tau2).

    Attributes:
        amplitude_px: A.
        settling_s: tau.
        second_amplitude_px: A2.
        second_settling_s: tau2.
    """

    name: ClassVar[str] = "flyback_settling"
    typical = (ByMagnification(0.5, 3.0), ByMagnification(5e-4, 2e-4))
    """0.5 px over 5 columns of 100 us, or 3 px over 40 columns of 5 us."""

    amplitude_px: float
    settling_s: float
    second_amplitude_px: float = 0.0
    second_settling_s: float = 1e-2

    def __post_init__(self) -> None:
        _require_positive(settling_s=self.settling_s, second_settling_s=self.second_settling_s)

    def offset_px(self, at: PixelVisits) -> Plane:
        """Exponential decays from the left edge."""
        in_row_s = at.x_px * at.scan.dwell_time_s
        terms = (self.amplitude_px, self.settling_s), (self.second_amplitude_px, self.second_settling_s)
        return _decays(in_row_s, *terms), np.zeros((1, 1))


@dataclass(frozen=True, slots=True)
class RowStartSettlingInPosition(Effect):
    """The start of each row is displaced over a length on the specimen, whatever the dwell time.

    u = [A exp(-x p / L) + A2 exp(-x p / L2)] / p with the pixel size p, as in a multi-beam microscope (templiert/scan_correction).

    Attributes:
        amplitude_um: A.
        length_um: L.
        second_amplitude_um: A2.
        second_length_um: L2.
    """

    name: ClassVar[str] = "row_start_settling_in_position"
    typical = (ByMagnification(0.625, 0.075), ByMagnification(50.0, 1.0))
    """0.5 px over 40 columns of 1.25 um, or 3 px over 40 columns of 25 nm."""

    amplitude_um: float
    length_um: float
    second_amplitude_um: float = 0.0
    second_length_um: float = 1.0

    def __post_init__(self) -> None:
        _require_positive(length_um=self.length_um, second_length_um=self.second_length_um)

    def offset_px(self, at: PixelVisits) -> Plane:
        """Exponential decays from the left edge."""
        pixel_um = at.scan.pixel_size_um
        terms = (self.amplitude_um, self.length_um), (self.second_amplitude_um, self.second_length_um)
        return _decays(at.x_px * pixel_um, *terms) / pixel_um, np.zeros((1, 1))


@dataclass(frozen=True, slots=True)
class FrameStartSettling(Effect):
    """The beam settles at the start of a scan: frame fly-back, relaxation of coils and lens.

    (u, v) = A exp(-y t_R / tau) + A2 exp(-y t_R / tau2).

    Attributes:
        amplitude_x_px: A in x.
        amplitude_y_px: A in y.
        settling_s: tau.
        second_x_px: A2 in x.
        second_y_px: A2 in y.
        second_settling_s: tau2.
    """

    name: ClassVar[str] = "frame_start_settling"
    typical = (ByMagnification(0.15, 1.0), ByMagnification(0.3, 2.0), ByMagnification(5.0, 0.5))
    """0.3 or 2 px for 5 or 0.5 s."""

    amplitude_x_px: float
    amplitude_y_px: float
    settling_s: float
    second_x_px: float = 0.0
    second_y_px: float = 0.0
    second_settling_s: float = 30.0

    def __post_init__(self) -> None:
        _require_positive(settling_s=self.settling_s, second_settling_s=self.second_settling_s)

    def offset_px(self, at: PixelVisits) -> Plane:
        """Exponential decays from the upper edge."""
        amplitudes = (self.amplitude_x_px, self.second_x_px), (self.amplitude_y_px, self.second_y_px)
        return _both(at.y_px * at.scan.row_time_s, *amplitudes, (self.settling_s, self.second_settling_s))


@dataclass(frozen=True, slots=True)
class FrameStartSettlingInPosition(Effect):
    """The start of each frame is displaced over a length on the specimen, whatever the row time.

    (u, v) = [A exp(-y p / L) + A2 exp(-y p / L2)] / p with the pixel size p.

    Attributes:
        amplitude_x_um: A in x.
        amplitude_y_um: A in y.
        length_um: L.
        second_x_um: A2 in x.
        second_y_um: A2 in y.
        second_length_um: L2.
    """

    name: ClassVar[str] = "frame_start_settling_in_position"
    typical = (ByMagnification(0.19, 0.025), ByMagnification(0.375, 0.05), ByMagnification(62.5, 1.25))
    """0.3 px over 50 rows of 1.25 um, or 2 px over 50 rows of 25 nm."""

    amplitude_x_um: float
    amplitude_y_um: float
    length_um: float
    second_x_um: float = 0.0
    second_y_um: float = 0.0
    second_length_um: float = 1.0

    def __post_init__(self) -> None:
        _require_positive(length_um=self.length_um, second_length_um=self.second_length_um)

    def offset_px(self, at: PixelVisits) -> Plane:
        """Exponential decays from the upper edge."""
        pixel_um = at.scan.pixel_size_um
        amplitudes = (self.amplitude_x_um, self.second_x_um), (self.amplitude_y_um, self.second_y_um)
        u, v = _both(at.y_px * pixel_um, *amplitudes, (self.length_um, self.second_length_um))
        return u / pixel_um, v / pixel_um
