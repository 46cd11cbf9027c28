"""Plan of an experiment: duration, expected noise, false strain, stop distances, and advice."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from semlive import dic, mechanics
from semlive.data.drift import DistortionField
from semlive.data.experiment import Phase
from semlive.data.frame import ExportedFile, Frame, PatternQuality
from semlive.data.grid import Grid
from semlive.data.strain import Tensor2
from semlive.engine import start
from semlive.engine.schedule import Schedule, TimingAssumptions, schedule
from semlive.errors import BadImage, BadInput
from semlive.formats import read_frame
from semlive.inputs.files import MAX_IMAGE_BYTES, read_regular
from semlive.inputs.mask_file import read_mask
from semlive.service.config.configuration import Config
from semlive.service.diagnosis.model_file import Model, require_compatible
from semlive.service.planning.advice import advice
from semlive.service.planning.recommendation import GaugeNoise, Recommendation, gauge_noise, recommendation
from semlive.service.planning.stop_distances import StopPlan, stop_plan
from semlive.service.replay.replay import ReplayCallbacks, result_from_maps
from semlive.service.watch.sidecars import sidecar_of

GAUGES = (5, 9, 13, 17, 25, 33)
"""Edges of virtual strain gauges, in points, whose noise is shown with that of the configured one."""


@dataclass(frozen=True, slots=True)
class Scan:
    """Scan of one frame.

    Attributes:
        width_px: width of a frame.
        height_px: height of a frame.
        dwell_s: time on one pixel in one frame, all integrations and passes included; None if unknown.
        frame_s: duration of one frame, all integrations included.
        pixel_size_m: edge of a pixel.
        source: source of these values.
        vendor: vendor of the test frame; None without one.
    """

    width_px: int
    height_px: int
    dwell_s: float | None
    frame_s: float
    pixel_size_m: float
    source: str
    vendor: str | None = None


@dataclass(frozen=True, slots=True)
class FalseStrain:
    """False strain of a translation without correction of the distortion.

    Attributes:
        shift_px: the translation (x, y).
        low: smallest value of each component over the field.
        high: largest value of each component.
    """

    shift_px: tuple[float, float]
    low: Tensor2
    high: Tensor2


@dataclass(frozen=True, slots=True, eq=False)
class ExperimentPlan:
    """Results of a plan.

    Attributes:
        scan: scan of one frame.
        schedule: expected times.
        grid: grid of the POI.
        quality: pattern quality of the test frame; None without one.
        gauges: strain noise over gage length; empty without a test frame.
        mean_sigma: expected standard uncertainty of the mean strain over the grid; None without a test frame.
        false_strain: false strain of each distinct translation.
        distortion: source of the distortion for the false strain.
        advice: texts, most urgent first.
        effects: names of the effects that the model corrects.
        stops: stop distances of the largest ramp; None if semlive does not move the load frame.
        recommended: recommended correlation for the test frame; None without one.
    """

    scan: Scan
    schedule: Schedule
    grid: Grid
    quality: PatternQuality | None
    gauges: tuple[GaugeNoise, ...]
    mean_sigma: Tensor2 | None
    false_strain: tuple[FalseStrain, ...]
    distortion: str
    advice: tuple[str, ...]
    effects: tuple[str, ...] = ()
    stops: StopPlan | None = None
    recommended: Recommendation | None = None


def plan_experiment(
    config: Config,
    test_frame: Path | None = None,
    log: Path | None = None,
    watch: ReplayCallbacks | None = None,
    *,
    force_noise_n: float = 0.0,
    force_resolution_n: float = 0.0,
) -> ExperimentPlan:
    """Plan an experiment without access to devices or export folder.

    Args:
        config: configuration of the run.
        test_frame: one frame of the specimen as the SEM exports it, with the scan of the run; None: the noise is not estimated.
        log: log of an earlier run at the same microscope and magnification, whose distortion is used; None: a typical distortion.
        watch: progress callbacks for reading that log.
        force_noise_n: standard deviation of the force reading under constant load, N.
        force_resolution_n: resolution of the force reading, N.

    Raises:
        BadInput: the plan violates its limits, the test frame cannot be read, or the duration of a frame is unknown.
    """
    plan = config.plan()
    start(plan, 0)  # rejects a plan that violates its limits, as the run does
    frame = None if test_frame is None else _test_frame(test_frame, config)
    scan = _scan(config, frame)
    if config.model is not None and frame is not None:
        require_compatible(
            Model(config.model, name="of this run"), (scan.width_px, scan.height_px), 1e6 * scan.pixel_size_m, frame.info.name
        )
    grid = dic.grid_for(config.dic, scan.width_px, scan.height_px)
    times = schedule(plan, TimingAssumptions(scan.frame_s, config.sem.stable_for_s + config.sem.poll_s))
    mask = None if frame is None else dic.mask_of(config.dic, (scan.height_px, scan.width_px))
    quality = None if frame is None else dic.quality(frame.image, grid, config.dic, mask=mask)
    gauges: tuple[GaugeNoise, ...] = ()
    mean_sigma = None
    if quality is not None and quality.usable.any():
        sigma_px = quality.median_sigma_px
        fit = config.estimate.strain
        windows = sorted({*GAUGES, config.estimate.window_points})
        gauges = tuple(gauge_noise(grid, points, sigma_px, fit) for points in windows if points <= min(grid.shape))
        mean_sigma = mechanics.expected_mean_sigma(grid, sigma_px)
    distortion, source = _distortion(log, grid, scan, watch)
    shifts = dict.fromkeys(step.shift_px for step in plan.steps if step.phase is not Phase.TENSION and step.shift_px != (0.0, 0.0))
    false_strains = tuple(_false_strain(distortion, shift, config.estimate.window_points) for shift in shifts)
    effects = tuple(effect.name for effect in config.analysis_settings().model.effects)
    stops = stop_plan(config, force_noise_n, force_resolution_n)
    in_view = tuple(effect for effect in false_strains if effect is not None)
    recommended = None
    if frame is not None:
        recommended = recommendation(frame.image, config.dic, config.estimate.window_points, config.estimate.strain)
    planned = ExperimentPlan(scan, times, grid, quality, gauges, mean_sigma, in_view, source, (), effects, stops, recommended)
    return replace(planned, advice=advice(config, planned))


def _test_frame(path: Path, config: Config) -> Frame:
    try:
        data, mtime_ns = read_regular(path, MAX_IMAGE_BYTES), path.stat().st_mtime_ns
    except OSError as error:
        raise BadImage(f"{path}: cannot be read ({error.strerror}); give one frame as the SEM exported it") from error
    sidecar_path = sidecar_of(path)
    sidecar = None if sidecar_path is None else read_regular(sidecar_path, MAX_IMAGE_BYTES)
    return read_frame(ExportedFile(0, path.name, data, "", mtime_ns, mtime_ns, sidecar), config.sem.scan_profile)


def _scan(config: Config, frame: Frame | None) -> Scan:
    if frame is not None:
        info, timing = frame.info, frame.info.timing
        dwell_s = timing.dwell_time_s.value * timing.integrations.value * timing.line_integrations.value
        return Scan(info.width_px, info.height_px, dwell_s, timing.duration_s, info.pixel_size_m.value, info.name, info.vendor)
    profile, (width, height) = config.sem.profile, _frame_size(config)
    frame_s = profile.frame_time_s or (None if profile.row_time_s is None else profile.row_time_s * height)
    if frame_s is None:
        raise BadInput(
            "the duration of a frame is unknown; give --test-frame FILE, one frame as the SEM exports it, or set sem.profile.frame_time_s"
        )
    return Scan(width, height, profile.dwell_time_s, frame_s, config.sem.pixel_size_um * 1e-6, "the configuration; its size is assumed")


def _frame_size(config: Config) -> tuple[int, int]:
    """Assumed (width, height) of a frame, px: that of the mask, or one around the region of interest."""
    if config.dic.mask is not None:
        height, width = read_mask(config.dic.mask).shape
        return width, height
    if config.dic.roi_px is None:
        return 1024, 884
    x0, y0, x1, y1 = config.dic.roi_px
    return max(1024, x0 + x1), max(884, y0 + y1)


def _distortion(log: Path | None, grid: Grid, scan: Scan, watch: ReplayCallbacks | None) -> tuple[DistortionField, str]:
    if log is None:
        typical = mechanics.typical_distortion(grid, scan.width_px, scan.height_px)
        return typical, "a typical one, as measured at x200 by Sutton et al. (2007); --log LOG uses that of your microscope"
    return result_from_maps(log, watch)[0].estimate.distortion, f"that of {log.name}"


def _false_strain(distortion: DistortionField, shift: tuple[float, float], window_points: int) -> FalseStrain | None:
    """False strain of a translation (x, y), px; None if no point remains in the field of view."""
    field = mechanics.false_strain(distortion, shift, min(window_points, *distortion.grid.shape))
    if not field.valid.any():
        return None
    values = [component[field.valid] for component in (field.exx, field.eyy, field.exy)]
    return FalseStrain(
        shift, Tensor2(*(float(np.min(component)) for component in values)), Tensor2(*(float(np.max(component)) for component in values))
    )
