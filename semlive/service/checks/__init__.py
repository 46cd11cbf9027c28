"""Checks before a run. Each finding names the item, its state and the remedy; nothing is moved."""

from semlive.service.checks.run_checks import run_checks

__all__ = ["run_checks"]
