"""Types that a user's script gets from semlive; pyright checks this file, and nothing runs it."""

from __future__ import annotations

from typing import assert_type

import numpy as np
import pandas
from matplotlib.figure import Figure
from numpy.typing import NDArray

import semlive
from semlive.api import OpenFrame, OpenLog


def script() -> None:
    """A user's script."""
    log = semlive.open_log("run.mcap", changes=["estimate.window=15"])
    assert_type(log, OpenLog)
    frame = log.frames[-1]
    assert_type(frame, OpenFrame)
    assert_type(log.frames[2:], list[OpenFrame])
    assert_type(frame.u, NDArray[np.float64])
    assert_type(frame.load_n, float | None)
    assert_type(log.plot("stress_strain"), Figure)
    assert_type(log.to_pandas(), pandas.DataFrame)
    assert_type(log.image(7), NDArray[np.uint8] | NDArray[np.uint16])
    log.plot("pie")  # pyright: ignore[reportArgumentType]
