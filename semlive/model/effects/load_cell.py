"""Effects that readings tell beside the strain of the maps: of the load cell, of clocks, and a lift that is strain to the maps."""

from __future__ import annotations

from dataclasses import dataclass

from semlive.model.effects.base import NamedEffect


@dataclass(frozen=True, slots=True)
class LoadEffectClass(NamedEffect):
    """An effect on what is read, or one that only readings tell.

    Attributes:
        rivals: names that the same readings would have as well.
    """

    rivals: tuple[str, ...] = ()


ZERO = LoadEffectClass(
    "load_cell_zero",
    "the load cell shows a load that is not there: F_m = F + z",
    "read the load with the specimen hanging free from one grip",
    "G7",
    ("preload",),
)
DRIFT = LoadEffectClass("load_cell_drift", "the load cell's zero wanders: F_m = F + r T", "read the load unloaded, before and after", "G7")
FRICTION = LoadEffectClass(
    "friction_hysteresis",
    "guides rub, and the load cell feels it: F_m = F + f sign(dF)",
    "unload in steps: friction changes its sign",
    "G7",
    ("refocus_magnification_step",),
)
CLOCK = LoadEffectClass(
    "timestamp_offset",
    "the microscope's clock differs from this computer's: the files say T + dt",
    "set one of the clocks, or state the difference in sem.profile.clock_offset_s",
    "G7",
)
OUT_OF_PLANE = LoadEffectClass(
    "out_of_plane_translation",
    "the specimen comes nearer to the lens as the load grows, and is magnified with it: (u, v) = k F (x - xc, y - yc)",
    "a strain gage on either side of the specimen, or the working distance in focus at each load",
    "G6",
    ("bending_misalignment",),
)
LOADS = (ZERO, DRIFT, FRICTION)
LOAD_CELL_EFFECTS = frozenset(effect.name for effect in LOADS)


def load_effect(name: str) -> LoadEffectClass | None:
    """The effect of readings or clocks of a name; None if it is none."""
    return next((family for family in (*LOADS, CLOCK, OUT_OF_PLANE) if family.name == name), None)
