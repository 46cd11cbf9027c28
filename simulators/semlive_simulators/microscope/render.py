"""Frames without a bench, for tests and for images with known true values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive_simulators.microscope.column import Column
from semlive_simulators.scenario import Scenario
from semlive_simulators.specimen.specimen import Motion, at_rest


def render_frame(
    scenario: Scenario, start_time_s: float = 0.0, motion: Motion | None = None, frame: int = 0, column: Column | None = None
) -> NDArray[np.unsignedinteger]:
    """One frame, as the bench scans it.

    Args:
        scenario: drift, distortion, speckle, detector and raster; use ``dataclasses.replace`` to change them.
        start_time_s: start of the scan, seconds since the run began, which is the start of the drift.
        motion: motion of the specimen; None for a specimen at rest (see `semlive_simulators.specimen.specimen.at_rest`).
        frame: number of the scan, which determines its noise.
        column: ``scenario.column()``; None computes it.

    Returns:
        (height, width) of the detector's dtype, without databar.
    """
    column = scenario.column() if column is None else column
    image = np.empty((scenario.scan.height_px, scenario.scan.width_px), dtype=scenario.detector.dtype)
    column.render_rows(image, 0, start_time_s, at_rest() if motion is None else motion, frame)
    return image
