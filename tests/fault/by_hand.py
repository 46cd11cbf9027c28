"""Helpers of several tests: a clock that the test sets, images, and whether a process runs."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import tifffile


@dataclass
class HandClock:
    """Wall time and experiment time are equal, and advance only when the test sets them."""

    ns: int = 10**18

    def now_ns(self) -> int:
        return self.ns

    def mono_ns(self) -> int:
        return self.ns


def image(seed: int) -> bytes:
    stream = BytesIO()
    tifffile.imwrite(stream, np.random.default_rng(seed).integers(0, 255, (40, 50), dtype=np.uint8), metadata=None)
    return stream.getvalue()


def lives(pid: int) -> bool:
    """Whether a process runs or is suspended; a zombie does not run."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state not in "ZX"
