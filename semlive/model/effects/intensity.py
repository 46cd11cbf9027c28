"""Effects of grey levels: the frames' intensity tells them, and displacements do not, or not alone."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.model.effects.base import NamedEffect


@dataclass(frozen=True, slots=True)
class IntensityEffectClass(NamedEffect):
    """An effect that changes grey levels or their sharpness."""


CONTAMINATION = IntensityEffectClass(
    "contamination",
    "carbon grows where the beam has been: I *= 1 - c T, mean and contrast alike",
    "pairs on a fresh field: contamination begins anew there, brightness and focus go on",
    "G12",
)
DEFOCUS = IntensityEffectClass(
    "defocus",
    "the focus wanders: the probe's sigma is r T px, added in squares, and the mean grey stays",
    "a focus series: the sharpest image is elsewhere when the focus has wandered, and carbon stays where it is",
    "G12",
)
GAMMA_CHANGE = IntensityEffectClass(
    "gamma_change",
    "brightness, contrast or gamma was changed: I -> 255 a (I / 255)^g + b from an instant on",
    "automatic contrast and brightness fixed, and the same pairs again",
    "G12",
)
CHARGING_JUMP = IntensityEffectClass(
    "charging_jump",
    "charge breaks down now and then: the picture jumps, with a flash in some rows",
    "a lower current or voltage, or a coat: flashes and jumps of charge become rarer, slips of the specimen do not",
    "G9",
)
INTENSITY_EFFECTS = (CONTAMINATION, DEFOCUS, GAMMA_CHANGE, CHARGING_JUMP)


def intensity_effect(name: str) -> IntensityEffectClass | None:
    """The effect of grey levels of a name; None if it is none."""
    return next((effect for effect in INTENSITY_EFFECTS if effect.name == name), None)
