"""How the DIC's noise of neighbouring points correlates, found by the DIC itself on two frames and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semlive import dic
from semlive.data.frame import ExportedFile, Frame
from semlive.data.grid import Grid
from semlive.data.settings import AnalysisSettings
from semlive.errors import BadInput
from semlive.formats.images.frames import read_frame
from semlive.formats.log.messages import SEM_ORIGINAL
from semlive.report.noise_propagation import NoiseCorrelation
from semlive.service.log.files import messages

DRAWS = 12


def exported_frame(log: Path, export: int, settings: AnalysisSettings) -> Frame:
    """A frame as it was exported.

    Raises:
        BadInput: the log does not hold it.
    """
    for message in messages(log):
        if message.topic == SEM_ORIGINAL and message.sequence == export:
            return read_frame(
                ExportedFile(export, f"export {export}", message.payload, "", message.log_time_ns, message.log_time_ns), settings.scan
            )
    raise BadInput(f"{log}: does not hold the bytes of export {export}; give a complete log")


def noise_correlation(
    first: NDArray[np.unsignedinteger],
    second: NDArray[np.unsignedinteger],
    grid: Grid,
    settings: AnalysisSettings,
    smear: dic.IntegrationBlur | None,
    draws: int = DRAWS,
) -> NoiseCorrelation:
    """Correlate two frames of a run with more noise on both, again and again; what differs between draws is noise.

    The noise is of the size that the correlation finds in the first. Neighbours 5 px apart share 0.88 of it by the overlap of their
    subsets; at x10,000 it is 0.86: a few steep edges weigh most, and frame 0 is smeared by another drift than the frames after it.
    The second is made like the first by `smear`, as in the run: that takes away noise of short waves, which a point feels, and keeps
    that of long ones, which wide gauges feel.
    """
    noise_grey = dic.prepare(first, grid, settings.dic).noise_grey
    maps = []
    for draw in range(draws):
        rng = np.random.default_rng(draw)
        item, two = (_noisier(image, noise_grey, rng) for image in (first, second))
        reference = dic.prepare(item, grid, settings.dic)
        maps.append(dic.correlate_with_matched_blur(reference, two, settings.dic, smear, reference_frame=0, current_frame=1))
    valid = np.all([item.valid for item in maps], axis=0)
    lags = -(-grid.subset_px // grid.step_px)
    found = []
    for name in ("u_px", "v_px"):
        drawn = np.array([getattr(item, name) for item in maps])
        noise = np.where(valid, drawn - drawn.mean(axis=0), np.nan)
        found += [_by_lag(noise, lags), _by_lag(noise.swapaxes(1, 2), lags)]
    return NoiseCorrelation(*found)


def _noisier(image: NDArray[np.unsignedinteger], noise_grey: float, rng: np.random.Generator) -> NDArray[np.unsignedinteger]:
    grey = np.rint(image + rng.normal(0.0, noise_grey, image.shape))
    return np.clip(grey, 0, np.iinfo(image.dtype).max).astype(image.dtype)


def _by_lag(noise: NDArray[np.float64], lags: int) -> NDArray[np.float64]:
    """(lags,) correlation along the last axis of (draws, n, m) noise."""
    last = noise.shape[2]
    products = [float(np.nanmean(noise[:, :, lag:] * noise[:, :, : last - lag])) for lag in range(lags)]
    return np.array(products) / products[0]
