"""Direct measurement of drift between two frames of a hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import PoiStatus
from semlive.data.drift import HoldDrift
from semlive.data.frame import Frame
from semlive.data.grid import grid_for
from semlive.data.settings import DicSettings
from semlive.dic.correlate import correlate
from semlive.dic.reference import prepare
from semlive.errors import IllPosed


def hold_drift(before: Frame, after: Frame, settings: DicSettings, mask: NDArray[np.bool_] | None = None) -> HoldDrift:
    """Image drift between two frames of the same hold.

    Args:
        before: first frame.
        after: second frame.
        settings: of the correlation.
        mask: (height, width) True where the first frame may be used; None: everywhere.

    Raises:
        BadInput: the frames differ in size, or no subset fits.
        IllPosed: fewer than half of the points converge.
    """
    reference = prepare(before.image, grid_for(settings, before.info.width_px, before.info.height_px), settings, mask)
    solutions = correlate(reference, after.image, settings, reference_frame=before.info.export, current_frame=after.info.export)
    if 2 * solutions.valid.sum() < np.count_nonzero(reference.status != PoiStatus.MASKED) or not solutions.valid.any():
        raise IllPosed(
            f"{after.info.name} shows less than half of the points of {before.info.name}: the drift between them cannot be measured"
        )
    interval_s = (after.info.start_time_ns.value - before.info.start_time_ns.value) / 1e9
    independent_points = max(
        1.0, solutions.valid.sum() * min(1.0, settings.step_px / settings.subset_px) ** 2
    )  # number of points without common pixels
    relative_time_sigma = np.hypot(before.info.start_sigma_s, after.info.start_sigma_s) / interval_s

    def rate(moved_px: NDArray[np.float64], sigma_px: NDArray[np.float64]) -> tuple[float, float]:
        rate_px_s = float(np.median(moved_px[solutions.valid])) / interval_s
        return rate_px_s, float(
            np.hypot(np.median(sigma_px[solutions.valid]) / np.sqrt(independent_points) / interval_s, rate_px_s * relative_time_sigma)
        )

    (x, sigma_x), (y, sigma_y) = rate(solutions.u_px, solutions.sigma_u_px), rate(solutions.v_px, solutions.sigma_v_px)
    times_ns = before.info.start_time_ns.value, after.info.end_time_ns
    return HoldDrift(before.info.export, after.info.export, *times_ns, (x, y), (sigma_x, sigma_y))
