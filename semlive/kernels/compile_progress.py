"""How far compiling is."""

from __future__ import annotations

import sys

from numba.core.dispatcher import Dispatcher


def compile_progress() -> tuple[int, int]:
    """How many kernels are compiled or loaded from the cache, and how many there are."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("semlive.kernels.")]
    named = [(module.__name__, one) for module in modules for one in vars(module).values() if isinstance(one, Dispatcher)]
    own = [one for name, one in named if one.py_func.__module__ == name]
    return sum(bool(one.signatures) for one in own), len(own)
