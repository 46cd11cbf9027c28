"""Deflection of the beam by the stray field of the mains: u += A sin(2 pi f T + phase), 17 nm for 0.1 uT at 30 kV and 14 mm."""

from semlive.model.effects.rows.family import RowEffectClass

MAINS_HZ = (50.0, 60.0)
OVERTONES = 4
FREQUENCY_TOLERANCE = 0.004
"""Relative tolerance for the errors of the mains frequency and of the row time."""


def owns(frequency_hz: float) -> bool:
    """Whether the frequency is a multiple of 50 or 60 Hz."""
    return any(abs(frequency_hz / (order * mains) - 1.0) < FREQUENCY_TOLERANCE for mains in MAINS_HZ for order in range(1, OVERTONES + 1))


FAMILY = RowEffectClass(
    "mains_hum",
    "the field of the mains deflects the beam: u += A sin(2 pi f T + phase)",
    "pairs with the rows synchronised to the mains, or a dwell that is 7 % longer: hum stays at its frequency",
    owns,
    group="G10",
)
