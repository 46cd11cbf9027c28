"""Effects observed in scalar readings: load cell, clock, and an out-of-plane translation that the maps show as strain."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.model.effects.base import NamedEffect


@dataclass(frozen=True, slots=True)
class LoadEffectClass(NamedEffect):
    """An effect on readings, or one that only readings show.

    Attributes:
        rivals: names of other effects that explain the same readings.
    """

    rivals: tuple[str, ...] = ()


ZERO = LoadEffectClass(
    "load_cell_zero",
    "the load cell has a zero offset: F_m = F + z",
    "read the load with the specimen hanging free from one grip",
    "G7",
    ("preload",),
)
DRIFT = LoadEffectClass(
    "load_cell_drift", "the zero of the load cell drifts: F_m = F + r T", "read the load unloaded, before and after", "G7"
)
FRICTION = LoadEffectClass(
    "friction_hysteresis",
    "friction of guides adds to the load reading: F_m = F + f sign(dF)",
    "unload in steps: friction changes its sign",
    "G7",
    ("refocus_magnification_step",),
)
CLOCK = LoadEffectClass(
    "timestamp_offset",
    "the microscope's clock differs from this computer's: time stamps are T + dt",
    "set one of the clocks, or configure the difference in sem.profile.clock_offset_s",
    "G7",
)
OUT_OF_PLANE = LoadEffectClass(
    "out_of_plane_translation",
    "the specimen moves towards the lens with the load and is magnified: (u, v) = k F (x - xc, y - yc)",
    "a strain gage on either side of the specimen, or the working distance in focus at each load",
    "G6",
    ("bending_misalignment",),
)
LOADS = (ZERO, DRIFT, FRICTION)
LOAD_CELL_EFFECTS = frozenset(effect.name for effect in LOADS)


def load_effect(name: str) -> LoadEffectClass | None:
    """The effect of load cell, clock or lift by name; None if there is none."""
    return next((family for family in (*LOADS, CLOCK, OUT_OF_PLANE) if family.name == name), None)
