"""Dictionary of row effects: they are too fast for disparity maps, whose subsets average over rows; row registration observes them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import ModelEffect

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
MAINS_HZ = (50.0, 60.0)
OVERTONES = 4
FREQUENCY_TOLERANCE = 0.004
"""Relative tolerance for the errors of the mains frequency and of the row time."""


@dataclass(frozen=True, slots=True)
class RowEffectClass:
    """An effect that shifts the image from row to row, or within rows.

    Attributes:
        name: canonical name.
        description: what happens, one sentence.
        discriminating_experiment: the experiment that separates it from confounded effects, one sentence.
        matches_frequency: whether waves of (m,) frequencies, Hz, belong to the class; None for independent shifts of every row.
        group: group of confounded effects, G1 ... G12, or None.
        sizes_px: smallest and largest expected size, px.
    """

    name: str
    description: str
    discriminating_experiment: str
    matches_frequency: Callable[[Array], Mask] | None = None
    group: str | None = None
    sizes_px: tuple[float, float] = (0.002, 2.0)


def _is_mains(frequency_hz: Array) -> Mask:
    """Whether each frequency is a multiple of 50 or 60 Hz."""
    lines_hz = np.outer(MAINS_HZ, np.arange(1, OVERTONES + 1)).reshape(-1, 1)
    return np.any(np.abs(frequency_hz / lines_hz - 1.0) < FREQUENCY_TOLERANCE, axis=0)


MAINS_HUM = RowEffectClass(
    "mains_hum",
    "the field of the mains deflects the beam: u += A sin(2 pi f T + phase)",
    "pairs with the rows synchronised to the mains, or a dwell that is 7 % longer: hum stays at its frequency",
    _is_mains,
    group="G10",
)
"""Deflection of the beam by the stray field of the mains, 17 nm for 0.1 uT at 30 kV and 14 mm."""
VIBRATION = RowEffectClass(
    "vibration",
    "specimen or column vibrate: u += A sin(2 pi f T + phase of the frame)",
    "pairs with pumps and chiller off, or an accelerometer; a dwell that is 7 % longer separates the frequency from its aliases",
    lambda frequency_hz: ~_is_mains(frequency_hz),
    group="G10",
)
"""Vibration of the specimen by floor, pumps, chiller or sound: one frequency, an independent phase in every frame."""
ROW_JITTER = RowEffectClass(
    "row_jitter",
    "every row has an independent shift: u += a(frame, row)",
    "pairs with half or twice the dwell: jitter of the scan generator keeps its size, vibration of the column changes with the row time",
)
"""Independent shift of every row along x by noise of the scan generator."""
PERIODIC_EFFECTS: tuple[RowEffectClass, ...] = (MAINS_HUM, VIBRATION)
"""Periodic effects, distinguished by their frequencies."""


def periodic_effect_of(frequency_hz: float) -> RowEffectClass:
    """The class of a wave, by its frequency, Hz."""
    is_hum = MAINS_HUM.matches_frequency
    return MAINS_HUM if is_hum is not None and bool(np.all(is_hum(np.array([frequency_hz])))) else VIBRATION


ROW_DICTIONARY: tuple[RowEffectClass, ...] = (*PERIODIC_EFFECTS, ROW_JITTER)


def row_effect(name: str) -> RowEffectClass | None:
    """The row effect of a name; None if there is none."""
    return next((effect for effect in ROW_DICTIONARY if effect.name == name), None)


def wave_frequencies_hz(effects: Iterable[ModelEffect]) -> tuple[float, ...]:
    """Frequencies of the waves among effects of a model."""
    waves = (effect for effect in effects if row_effect(effect.name) is not None)
    return tuple(value for effect in waves for name, value in effect.values if name.startswith("frequency"))
