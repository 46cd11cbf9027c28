"""Floor, pumps, chiller or sound shake the specimen: one frequency, another phase in every frame."""

from semlive.model.row_effects import mains_hum
from semlive.model.row_effects.family import RowFamily


def owns(frequency_hz: float) -> bool:
    """Everything that is not the mains'."""
    return not mains_hum.owns(frequency_hz)


FAMILY = RowFamily(
    "vibration",
    "specimen or column vibrate: u += A sin(2 pi f T + phase of the frame)",
    "pairs with pumps and chiller off, or an accelerometer; a dwell that is 7 % longer tells the frequency from its aliases",
    owns,
    group="G10",
)
