"""Series over a whole run, for people to look at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class LoadSeries:
    """Load and extension as sampled.

    Attributes:
        time_ns: (n,) experiment time, UTC ns.
        force_n: (n,) force, tension positive.
        extension_mm: (n,) crosshead extension.
        gage_strain: (n,) strain gage, NaN where it said nothing; None without one.
    """

    time_ns: NDArray[np.int64]
    force_n: NDArray[np.float64]
    extension_mm: NDArray[np.float64]
    gage_strain: NDArray[np.float64] | None = None
