"""Recommended correlation for a test frame, and the strain noise that results."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semlive import dic, mechanics
from semlive.data.grid import Grid
from semlive.data.settings import AnalysisSettings, DicSettings, StrainSettings
from semlive.data.strain import Tensor2
from semlive.errors import BadInput
from semlive.formats.images.image_files import read_picture
from semlive.inputs.files import MAX_IMAGE_BYTES, read_regular
from semlive.service.config.configuration import Config

MIN_WINDOW_POINTS = 3


@dataclass(frozen=True, slots=True)
class GaugeNoise:
    """Expected standard uncertainty of strain at one gage length.

    Attributes:
        window_points: edge of the gauge in POI.
        vsg_px: edge of the gauge in px, subset included.
        sigma: standard uncertainty of one gauge from the noise of the correlation.
    """

    window_points: int
    vsg_px: int
    sigma: Tensor2


@dataclass(frozen=True, slots=True)
class Recommendation:
    """Recommended correlation and its noise.

    Attributes:
        choice: method, subset, step and displacement noise.
        gauge: strain noise of the gauge whose length is nearest to that of the settings; None if it does not fit into the frame.
    """

    choice: dic.CorrelationChoice
    gauge: GaugeNoise | None


def gauge_noise(grid: Grid, window_points: int, sigma_px: tuple[float, float], fit: StrainSettings) -> GaugeNoise:
    """Strain noise of one gauge on a grid, for a displacement noise of u and v."""
    return GaugeNoise(window_points, grid.vsg_px(window_points), mechanics.expected_sigma(grid, window_points, sigma_px, fit))


def recommendation(
    image: NDArray[np.uint8] | NDArray[np.uint16], settings: DicSettings, window_points: int, fit: StrainSettings
) -> Recommendation:
    """Recommend a correlation for a frame; its gauge has about the length of that of the settings.

    Args:
        image: (height, width) uint8 or uint16.
        settings: of the correlation; region, interpolation and shape function are kept.
        window_points: edge of the gauge of the settings, in POI.
        fit: settings of the strain fit.

    Raises:
        BadInput: the image has another form, or no subset fits.
    """
    choice = dic.recommend(image, settings)
    height, width = image.shape
    length_px = (window_points - 1) * settings.step_px + settings.subset_px
    grid = dic.grid_for(replace(settings, subset_px=choice.subset_px, step_px=choice.step_px), width, height)
    halves = max(round((length_px - choice.subset_px) / (2.0 * choice.step_px)), MIN_WINDOW_POINTS // 2)
    points = 2 * halves + 1
    sigma_px = (choice.sigma_u_px, choice.sigma_v_px)
    fits = points <= min(grid.shape) and max(sigma_px) > 0.0
    return Recommendation(choice, gauge_noise(grid, points, sigma_px, fit) if fits else None)


def recommendation_for_file(path: Path, config: Config | None) -> Recommendation:
    """Recommend a correlation for an image file.

    Args:
        path: image file; a databar is cropped if its header describes one.
        config: configuration of a run; None: the defaults for the complete frame.

    Raises:
        BadInput: the file cannot be read, or no subset fits.
    """
    try:
        data = read_regular(path, MAX_IMAGE_BYTES)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); give an image file that exists") from error
    image = read_picture(data, str(path))
    if config is None:
        defaults = AnalysisSettings(dic=DicSettings(roi_px=None))
        return recommendation(image, defaults.dic, defaults.estimate.window_points, defaults.estimate.strain)
    return recommendation(image, config.dic, config.estimate.window_points, config.estimate.strain)
