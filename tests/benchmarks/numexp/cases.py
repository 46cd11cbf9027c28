"""The cases: what differs from the paper's numerical experiment."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from numexp.noise import NoiseKind

from semlive_simulators.effects.drift import BaselineDriftUnderresolved
from semlive_simulators.effects.image_field import MagnificationDrift
from semlive_simulators.effects.interfaces import Effect

Effects = Callable[[int], tuple[Effect, ...]]
MAGNIFICATION_CHANGE = 5e-4
MAGNIFICATION_TAU_S = 3600.0
WANDER_PX = 0.3
END_S = 6320.0  # of 30 frames


@dataclass(frozen=True, slots=True)
class Setting:
    """What is imaged; cases that differ in noise alone share it.

    Attributes:
        effects: of a seed; beyond drift and distortion.
        load_steps: pairs under load after the calibration.
        carried: whether the distortion is carried along by the drift, as in equation 9 of the paper.
    """

    effects: Effects
    load_steps: int = 0
    carried: bool = False


@dataclass(frozen=True, slots=True)
class Case:
    """One row, or several rows, of the table.

    Attributes:
        name: short.
        about: one line.
        setting: what is imaged.
        noise: kind.
        noise_px: standard deviation of a map's component.
    """

    name: str
    about: str
    setting: Setting
    noise: NoiseKind
    noise_px: float = 0.025


def _nothing(seed: int) -> tuple[Effect, ...]:
    del seed
    return ()


def _wander(seed: int) -> tuple[Effect, ...]:
    """0.3 px rms along each axis, periods from four minutes (2.5 frames) to an hour."""
    return (BaselineDriftUnderresolved(WANDER_PX, 240.0, 3600.0, seed),)


def _magnification(seed: int) -> tuple[Effect, ...]:
    """The total is what the exponential reaches at the end of 30 frames."""
    del seed
    return (MagnificationDrift(MAGNIFICATION_CHANGE / -math.expm1(-END_S / MAGNIFICATION_TAU_S), MAGNIFICATION_TAU_S),)


def magnification_growth(begin_s: float, end_s: float) -> float:
    """True relative change of the magnification between two instants."""
    reached = [math.expm1(-time_s / MAGNIFICATION_TAU_S) / math.expm1(-END_S / MAGNIFICATION_TAU_S) for time_s in (begin_s, end_s)]
    return MAGNIFICATION_CHANGE * (reached[1] - reached[0])


PLAIN = Setting(_nothing)
EQUATION_9 = Setting(_nothing, carried=True)
CASES = {
    case.name: case
    for case in (
        Case("smooth", "quadratic drift, white noise of 0.025 px in every map", PLAIN, NoiseKind.WHITE),
        Case("correlated", "quadratic drift, 0.025 px of noise shared over 43 px subsets", PLAIN, NoiseKind.CORRELATED),
        Case("exact", "quadratic drift, no noise", PLAIN, NoiseKind.NONE, 0.0),
        Case("paper", "equation 9 with 0.025 px in every position, 0.035 px in every map", EQUATION_9, NoiseKind.WHITE, 0.025 * 2**0.5),
        Case("paper_exact", "equation 9, no noise", EQUATION_9, NoiseKind.NONE, 0.0),
        Case("wander", "0.3 px rms of wandering drift on top, correlated noise", Setting(_wander), NoiseKind.CORRELATED),
        Case("magnification", "magnification drifts by 5e-4, correlated noise", Setting(_magnification), NoiseKind.CORRELATED),
        Case("tension", "seven load steps up to 3e-3 after the calibration, correlated noise", Setting(_nothing, 7), NoiseKind.CORRELATED),
    )
}
