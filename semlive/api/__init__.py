"""A log for Python: arrays, data frames, images, figures and configuration.

log = semlive.open_log("my-run.mcap")
log.frames[7].u                 # (ny, nx) corrected displacement in px
log.drift.time_s, log.drift.dx_px
log.to_pandas()                 # one row for each frame
log.image(7)                    # (height, width) grey levels
log.plot("fields", frame=7)     # a matplotlib figure
log.to_xarray().eyy.sel(frame=7).plot()
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from semlive.api.frames import Distortion, Drift, OpenFrame, OpenFrames
from semlive.api.log import OpenLog
from semlive.service.config.overrides import parse_changes
from semlive.service.log.pairs import has_images
from semlive.service.replay.replay import ReplayCallbacks, ReplayRequest, Source, replay, require_calibration

__all__ = ["Distortion", "Drift", "OpenFrame", "OpenFrames", "OpenLog", "open_log"]


def open_log(path: str | Path, *, method: str | None = None, changes: Sequence[str] = (), from_images: bool = False) -> OpenLog:
    """Open a log for Python; its disparity maps are read and the estimate is made from them, seconds for some tens of pairs.

    Args:
        path: one MCAP file, or a run folder of segments.
        method: of estimation, ``joint`` or ``sutton2007``; by default the log's own.
        changes: of settings, as in ``["estimate.window=15"]``.
        from_images: correlate the images again.

    Raises:
        BadInput: the log cannot be read, or a setting is wrong.
        PoorCalibration: the run has load steps, and its translations do not determine the distortion;
            ``changes=["estimate.accept_poor_calibration=true"]`` opens it all the same.
    """
    log, parsed = Path(path), parse_changes(changes)
    images = from_images or any(change.of_images for change in parsed)
    source = Source.IMAGES if images and has_images(log) else Source.DISPARITY
    done = replay(ReplayRequest(log, method, parsed, source), ReplayCallbacks(frame=lambda _: None))
    require_calibration(log, done)
    return OpenLog(log, done)
