"""Vibration of the specimen by floor, pumps, chiller or sound: one frequency, an independent phase in every frame."""

from semlive.model.effects.rows import mains_hum
from semlive.model.effects.rows.family import RowEffectClass


def owns(frequency_hz: float) -> bool:
    """Whether the frequency is not a multiple of the mains frequency."""
    return not mains_hum.owns(frequency_hz)


FAMILY = RowEffectClass(
    "vibration",
    "specimen or column vibrate: u += A sin(2 pi f T + phase of the frame)",
    "pairs with pumps and chiller off, or an accelerometer; a dwell that is 7 % longer separates the frequency from its aliases",
    owns,
    group="G10",
)
