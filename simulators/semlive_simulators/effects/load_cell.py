"""Effects on the readings of load cell and extension."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.specimen.specimen import Motion


@dataclass(frozen=True, slots=True)
class LoadCellZero(Effect):
    """The load cell has a zero offset.

    F_m = F + z.

    Attributes:
        zero_n: z.
    """

    name: ClassVar[str] = "load_cell_zero"
    typical = (20.0,)
    """20 N, about 1 % of the largest load."""

    zero_n: float

    def load_reading_n(self, reading_n: float, time_s: float, motion: Motion) -> float:
        """Add the zero offset."""
        return reading_n + self.zero_n


@dataclass(frozen=True, slots=True)
class LoadCellGain(Effect):
    """The calibration of the load cell has a gain error.

    F_m = (1 + g) F.

    Attributes:
        gain_error: g.
    """

    name: ClassVar[str] = "load_cell_gain"
    typical = (0.02,)
    """2 %."""

    gain_error: float

    def load_reading_n(self, reading_n: float, time_s: float, motion: Motion) -> float:
        """Multiply by the gain."""
        return (1 + self.gain_error) * reading_n


@dataclass(frozen=True, slots=True)
class LoadCellDrift(Effect):
    """The reading of the load cell drifts while its bridge warms up.

    F_m = F + r T.

    Attributes:
        rate_n_per_s: r.
    """

    name: ClassVar[str] = "load_cell_drift"
    typical = (0.002,)
    """7 N in an hour."""

    rate_n_per_s: float

    def load_reading_n(self, reading_n: float, time_s: float, motion: Motion) -> float:
        """Add the drift."""
        return reading_n + self.rate_n_per_s * time_s


@dataclass(frozen=True, slots=True)
class LoadFrameCompliance(Effect):
    """Compliance of the fixtures, which the extension includes.

    d = F / k_s + F / k_f.

    Attributes:
        fixture_stiffness_n_mm: k_f.
    """

    name: ClassVar[str] = "load_frame_compliance"
    typical = (5000.0,)
    """5000 N/mm, a third of that of the specimen."""

    fixture_stiffness_n_mm: float

    def extension_reading_mm(self, reading_mm: float, load_n: float) -> float:
        """Add the elongation of the fixtures."""
        return reading_mm + load_n / self.fixture_stiffness_n_mm


@dataclass(frozen=True, slots=True)
class FrictionHysteresis(Effect):
    """Friction of guides: the load cell measures more than the load of the specimen during loading, and less during unloading.

    F_m = F + f sign(dF), dF the last load step.

    Attributes:
        friction_n: f.
    """

    name: ClassVar[str] = "friction_hysteresis"
    typical = (15.0,)
    """15 N."""

    friction_n: float

    def load_reading_n(self, reading_n: float, time_s: float, motion: Motion) -> float:
        """Add friction in the direction of the last load step."""
        changes_n = [step.change_n for step in motion.history.load_steps if step.time_s <= time_s and step.change_n != 0]
        return reading_n + (math.copysign(self.friction_n, changes_n[-1]) if changes_n else 0.0)
