"""What tests of the watched folder have in common: a clock that is moved by hand, and images."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np
import tifffile


@dataclass
class HandClock:
    """Wall time and experiment time are the same, and go on when told."""

    ns: int = 10**18

    def now_ns(self) -> int:
        return self.ns

    def mono_ns(self) -> int:
        return self.ns


def image(seed: int) -> bytes:
    stream = BytesIO()
    tifffile.imwrite(stream, np.random.default_rng(seed).integers(0, 255, (40, 50), dtype=np.uint8), metadata=None)
    return stream.getvalue()
