"""Optional libraries of the Python interface, with a clear error where one is not installed."""

from __future__ import annotations

import importlib
from typing import Any

from semlive.errors import BadInput


def optional_library(name: str, method: str) -> Any:
    """Return an optional library.

    Args:
        name: its name, which is also that of the extra of semlive.
        method: what needs it, for the message.

    Raises:
        BadInput: it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise BadInput(f"{method}: {name} is not installed; pip install semlive[{name}].") from None
