"""Effects on the deflection of the beam: hum, vibration, jitter and nonlinear ramps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import ByMagnification, Effect, PixelVisits, Plane
from semlive_simulators.kernels.exposure import gaussians
from semlive_simulators.kernels.pattern import gaussian


@dataclass(frozen=True, slots=True)
class RowJitter(Effect):
    """Random horizontal offset of each row: noise of the scan generator, stray fields, acoustic noise.

    u = a(frame, visit, row), white and normal.

    Attributes:
        sd_px: standard deviation.
        seed: seed of the jitter.
    """

    name: ClassVar[str] = "row_jitter"
    typical = (ByMagnification(0.03, 0.2),)
    """0.03 or 0.2 px."""

    sd_px: float
    seed: int = 1

    def offset_px(self, at: PixelVisits) -> Plane:
        """One offset in x per row."""
        rows = at.y_px.shape[0]
        stream = 1_000_003 * at.frame + at.visit
        return self.sd_px * gaussians(self.seed, stream, int(at.y_px[0, 0]), rows)[:, None], np.zeros((1, 1))


@dataclass(frozen=True, slots=True)
class MainsHum(Effect):
    """Stray magnetic field of the mains, about 17 nm for 0.1 uT at 30 kV and 14 mm.

    (u, v) = A sum_n a_n sin(n (2 pi f T + phase)), T the time since the run began: its phase at a frame start is practically random.

    Attributes:
        amplitude_x_px: A in x.
        amplitude_y_px: A in y.
        frequency_hz: frequency of the mains.
        phase_rad: phase at the start of the run.
        harmonics: (n, a_n) of each overtone, a_n as a fraction of A; a_1 is 1.
    """

    name: ClassVar[str] = "mains_hum"
    typical = (ByMagnification(0.02, 0.5), ByMagnification(0.01, 0.25), 50.0, 0.4)
    """0.02 or 0.5 px at 50 Hz."""

    amplitude_x_px: float
    amplitude_y_px: float
    frequency_hz: float
    phase_rad: float
    harmonics: tuple[tuple[int, float], ...] = ()

    def offset_px(self, at: PixelVisits) -> Plane:
        """Equal waves in both axes."""
        angle = 2 * np.pi * self.frequency_hz * at.time_s + self.phase_rad
        wave = np.sin(angle)
        for order, fraction in self.harmonics:
            wave = wave + fraction * np.sin(order * angle)
        return self.amplitude_x_px * wave, self.amplitude_y_px * wave


@dataclass(frozen=True, slots=True)
class LineSyncHum(Effect):
    """Mains hum with rows triggered by the mains: equal in every row, a static pattern of columns.

    u = A sin(2 pi f x t_D).

    Attributes:
        amplitude_px: A.
        frequency_hz: frequency of the mains.
    """

    name: ClassVar[str] = "line_sync_hum"
    typical = (ByMagnification(0.02, 0.5), 50.0)
    """0.02 or 0.5 px at 50 Hz."""

    amplitude_px: float
    frequency_hz: float

    def offset_px(self, at: PixelVisits) -> Plane:
        """A wave along x."""
        wave = np.sin(2 * np.pi * self.frequency_hz * at.x_px * at.scan.dwell_time_s)
        return self.amplitude_px * wave, np.zeros((1, 1))


@dataclass(frozen=True, slots=True)
class Vibration(Effect):
    """Vibration by floor, pumps, chiller or sound: one frequency, with a random phase in each frame.

    (u, v) = A sin(2 pi (f tau + phase of the frame)), tau the time in the frame, the phase a normally distributed number of turns.

    Attributes:
        amplitude_x_px: A in x.
        amplitude_y_px: A in y.
        frequency_hz: frequency, 0.1 to 200 Hz.
        seed: seed of the phases.
    """

    name: ClassVar[str] = "vibration"
    typical = (ByMagnification(0.01, 0.3), ByMagnification(0.01, 0.2), 23.7)
    """0.01 or 0.3 px at 23.7 Hz."""

    amplitude_x_px: float
    amplitude_y_px: float
    frequency_hz: float
    seed: int = 1

    def offset_px(self, at: PixelVisits) -> Plane:
        """Equal waves in both axes."""
        wave = np.sin(2 * np.pi * (self.frequency_hz * at.in_frame_s + gaussian(self.seed, 4, at.frame)))
        return self.amplitude_x_px * wave, self.amplitude_y_px * wave


@dataclass(frozen=True, slots=True)
class ScanNonlinearity(Effect):
    """Non-linear scan ramps, and hysteresis of the coil cores.

    u = q X^2 + k X^3 +- h (1 - X^2), v = q Y^2 + k Y^3, with X, Y = -1 ... 1 and minus in rows scanned from right to left.

    Attributes:
        quadratic_px: q.
        cubic_px: k.
        hysteresis_px: h.
    """

    name: ClassVar[str] = "scan_nonlinearity"
    typical = (ByMagnification(0.6, 1.2), ByMagnification(0.4, 0.8), ByMagnification(0.1, 0.2))
    """About 1 or 2 px in the corners."""

    quadratic_px: float
    cubic_px: float
    hysteresis_px: float

    def offset_px(self, at: PixelVisits) -> Plane:
        """A function of the column in x, and of the row in y."""
        x, y = at.from_centre_px
        X, Y = x / (0.5 * (at.scan.width_px - 1)), y / (0.5 * (at.scan.height_px - 1))
        sign = np.where(at.reversed_rows, -1.0, 1.0)
        u = self.quadratic_px * X**2 + self.cubic_px * X**3 + sign * self.hysteresis_px * (1 - X**2)
        return u, self.quadratic_px * Y**2 + self.cubic_px * Y**3
