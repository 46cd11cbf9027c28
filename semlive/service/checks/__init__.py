"""Is everything in place that a run needs? Each finding says what was looked at, what is so, and how to mend it; nothing is moved."""

from semlive.service.checks.run_checks import run_checks

__all__ = ["run_checks"]
