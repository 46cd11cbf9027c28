"""Effects on the grey levels: the intensity of the frames shows them, displacements do not, or not alone."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.model.effects.base import NamedEffect


@dataclass(frozen=True, slots=True)
class IntensityEffectClass(NamedEffect):
    """An effect that changes grey levels or their sharpness."""


CONTAMINATION = IntensityEffectClass(
    "contamination",
    "carbon grows where the beam has been: I *= 1 - c T, mean and contrast alike",
    "pairs on a fresh field: contamination restarts there, brightness and focus changes continue",
    "G12",
)
DEFOCUS = IntensityEffectClass(
    "defocus",
    "the focus drifts: the probe's sigma is r T px, added in quadrature, and the mean grey level is constant",
    "a focus series: the sharpest image has moved if the focus has drifted; contamination does not change it",
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
    "charge breaks down at random instants: the image jumps, with a flash in some rows",
    "a lower current or voltage, or a coat: flashes and jumps of charge become rarer, slips of the specimen do not",
    "G9",
)
INTENSITY_EFFECTS = (CONTAMINATION, DEFOCUS, GAMMA_CHANGE, CHARGING_JUMP)


def intensity_effect(name: str) -> IntensityEffectClass | None:
    """The intensity effect of a name; None if there is none."""
    return next((effect for effect in INTENSITY_EFFECTS if effect.name == name), None)
