"""Every scenario, by name."""

from __future__ import annotations

from . import readme_link, readme_motion
from .scenario import Scenario

ALL: tuple[Scenario, ...] = (*readme_motion.SCENARIOS, *readme_link.SCENARIOS)
