"""Every scenario with a fault, by name."""

from __future__ import annotations

from . import own_cell, own_course, own_drive, own_phase, readme_link, readme_motion
from .scenario import Scenario

ALL: tuple[Scenario, ...] = (
    *readme_motion.SCENARIOS,
    *readme_link.SCENARIOS,
    *own_phase.SCENARIOS,
    *own_cell.SCENARIOS,
    *own_drive.SCENARIOS,
    *own_course.SCENARIOS,
)
