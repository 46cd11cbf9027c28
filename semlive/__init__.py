"""Live drift- and distortion-corrected strain measurement in the scanning electron microscope.

``semlive.open_log(path)`` opens a log for Python; everything else is the command line's.
"""

from __future__ import annotations

TYPE_CHECKING = False  # a start that Ctrl-C interrupts in the import of typing would print a traceback
if TYPE_CHECKING:
    from semlive.api import open_log

__version__ = "0.2.0"
"""Version of the package, the same as in pyproject.toml."""

__all__ = ["__version__", "open_log"]


def __getattr__(name: str) -> object:
    """`open_log`, imported when it is first asked for: the package itself stays light."""
    if name == "open_log":
        from semlive.api import open_log  # noqa: PLC0415

        return open_log
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
