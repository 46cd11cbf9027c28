"""What would make an experiment better, from what is known of it before it is run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from semlive.data.experiment import Phase
from semlive.service.config.configuration import Config
from semlive.service.planning.stop_distances import stop_advice

if TYPE_CHECKING:
    from semlive.service.planning.planning import ExperimentPlan

TARGET_STRAIN = 1e-3
"""Noise of one gauge above which its map shows little of a metal's elastic strain (1e-3 is 70 MPa in aluminium)."""
SAME_PIXEL = 0.02
"""Relative difference of pixel sizes that rounding and calibration explain."""
SUFFICIENT_SHIFT_PX = 12.0
"""A cross of 8 px on the paper's grid leaves the distortion as uncertain as is allowed, one of 12 px less."""
MIN_ROI_FRACTION = 0.8
"""Part of the picture that a grid covers; 0.96 instead of 0.54 took a third off the strain error of the correction
(docs/validation/paper.md)."""
LONG_FRAME_S = 180.0
LONG_RUN_S = 6 * 3600.0
PAPER_HOLD_S = 30.0


def advice(config: Config, planned: ExperimentPlan) -> tuple[str, ...]:
    """Sentences that say what is wrong and what to set instead, most urgent first.

    Args:
        config: of the run.
        planned: all else that is known of it.
    """
    return (
        *_test_frame(config, planned),
        *stop_advice(planned.stops),
        *_times(config, planned),
        *_shifts(config, planned),
        *_pattern(config, planned),
        *_steps(config),
    )


def _test_frame(config: Config, planned: ExperimentPlan) -> Iterator[str]:
    """Where the test frame contradicts the configuration; silent without one."""
    scan, sem = planned.scan, config.sem
    if scan.vendor is None:
        return
    if sem.vendor not in (None, scan.vendor):
        yield f"sem.vendor is {sem.vendor}, but the test frame is of {scan.vendor}: no file like it would ever count as complete"
    ratio = 1e6 * scan.pixel_size_m / sem.pixel_size_um
    if abs(ratio - 1.0) > SAME_PIXEL:
        yield (
            f"sem.pixel_size_um is {sem.pixel_size_um:g}, the test frame's pixels are {1e6 * scan.pixel_size_m:.4g} um: "
            f"shifts would be {1.0 / ratio:.2g} times what the plan says"
        )


def _times(config: Config, planned: ExperimentPlan) -> Iterator[str]:
    hold, scan_s = config.plan().hold, planned.scan.frame_s
    needed_s = 2.0 * scan_s + config.sem.stable_for_s + config.sem.poll_s
    if hold.frame_timeout_s < needed_s:
        yield f"protocol.frame_timeout_s of {hold.frame_timeout_s:g} s is less than two scans take: set it above {1.5 * needed_s:.0f}"
    if hold.hold_s < PAPER_HOLD_S and config.protocol.loads_n:
        yield f"a hold of {hold.hold_s:g} s leaves relaxation in the pair: set protocol.hold_s to {PAPER_HOLD_S:g}, or adaptive_hold"
    if scan_s > LONG_FRAME_S:
        yield f"a frame takes {scan_s:.0f} s, over which drift bends: scan faster and integrate frames"
    if planned.schedule.duration_s > LONG_RUN_S:
        yield f"the run takes {planned.schedule.duration_s / 3600:.1f} h: fewer calibration shifts or a shorter dwell make it shorter"
    if config.protocol.warm_up is None and config.estimate.method == "joint":
        yield "nothing waits for the drift to settle: begin 15 to 30 min after the beam was switched on, or set protocol.warm_up"
    if (
        config.protocol.loads_n
        and planned.schedule.steps
        and config.protocol.motion_timeout_s < max(one.motion_s for one in planned.schedule.steps)
    ):
        yield "protocol.motion_timeout_s is shorter than the longest ramp takes: raise it, or ramp_rate_n_s"


def _shifts(config: Config, planned: ExperimentPlan) -> Iterator[str]:
    shifts = np.array(config.protocol.calibration_shifts_px or [(0.0, 0.0)])
    span_x, span_y = np.ptp(shifts, axis=0)
    if min(span_x, span_y) < 1.0:
        missing = "both directions" if max(span_x, span_y) < 1.0 else f"the {'x' if span_x < 1.0 else 'y'} direction"
        refused = "" if config.estimate.accept_poor_calibration or not config.protocol.loads_n else ", and nothing will be loaded"
        yield f"no calibration shift leads in {missing}, so distortion cannot be told{refused}: add shifts of 16 to 32 px along x and y"
    elif np.abs(shifts).max(axis=0).min() < SUFFICIENT_SHIFT_PX:
        yield (
            f"calibration shifts reach {np.abs(shifts)[:, 0].max():g} px along x and {np.abs(shifts)[:, 1].max():g} px along y: below "
            f"{SUFFICIENT_SHIFT_PX:g} px the calibration may be refused before the first load; 16 to 32 px are usual"
        )
    elif len(config.protocol.calibration_shifts_px) < 7:
        yield f"{len(config.protocol.calibration_shifts_px)} calibration pairs are few: 9 to 17 shifts on a cross are usual"
    grid, scan, half = planned.grid, planned.scan, planned.grid.subset_px // 2
    reach = np.abs(shifts).max(axis=0)
    margin = (
        min(grid.x_px[0], scan.width_px - 1 - grid.x_px[-1]) - half,
        min(grid.y_px[0], scan.height_px - 1 - grid.y_px[-1]) - half,
    )
    if reach[0] > margin[0] or reach[1] > margin[1]:
        yield (
            f"shifts of up to {reach[0]:.0f} x {reach[1]:.0f} px move points out of the frame, whose margin is {margin[0]:.0f} x "
            f"{margin[1]:.0f} px: they are missing there; where strain is wanted up to the edge, make the shifts smaller"
        )
    seen = np.ptp(grid.x_px) * np.ptp(grid.y_px) / ((scan.width_px - 2.0 * half) * (scan.height_px - 2.0 * half))
    if scan.vendor is not None and seen < MIN_ROI_FRACTION:
        yield (
            f"dic.roi_px leaves out {100.0 * (1.0 - seen):.0f} % of where points could be: all of them tell of the distortion, "
            "so a roi up to the edge makes strain in the middle truer, too"
        )


def _pattern(config: Config, planned: ExperimentPlan) -> Iterator[str]:
    quality = planned.quality
    if quality is None:
        yield "without --test-frame the noise of displacement and strain stays open: scan one frame of the specimen and give it"
        return
    yield from quality.warnings
    window = config.estimate.window_points
    gauge = next((one for one in planned.gauges if one.window_points == window), None)
    if gauge is not None and (sigma := max(gauge.sigma.exx, gauge.sigma.eyy)) > TARGET_STRAIN:
        longer = next((one for one in planned.gauges if max(one.sigma.exx, one.sigma.eyy) <= TARGET_STRAIN), None)
        wider = "" if longer is None else f"estimate.window_points: {longer.window_points} ({longer.vsg_px} px), or "
        times = (sigma / TARGET_STRAIN) ** 2
        yield f"one gauge of {gauge.vsg_px} px will scatter by {sigma:.1e}: take {wider}dwell {times:.1f} times as long"
    step, subset = planned.grid.step_px, planned.grid.subset_px
    if step > subset // 2:
        yield f"dic.step_px of {step} leaves gaps between subsets of {subset} px: {max(subset // 4, 1)} shows more at the same noise"
    elif step < subset // 12:
        yield f"dic.step_px of {step} measures the same pixels {subset // step} times over: {max(subset // 8, 1)} is as good and faster"


def _steps(config: Config) -> Iterator[str]:
    loads = config.protocol.loads_n
    if loads and len(set(loads)) < 3:
        yield "fewer than three different loads: no line can be told from a curve; add loads_n"
    if loads and config.specimen.area_mm2 is None:
        yield "specimen.area_mm2 is not set: there will be no stress and no elastic constants"
    if loads and config.limits is not None and config.limits.force_max_n > 1.5 * max(loads):
        yield f"limits.force_max_n of {config.limits.force_max_n:g} N is far above the largest load: {1.1 * max(loads):.0f} N stops earlier"
    unloaded = [step for step in config.plan().steps if step.phase is Phase.TRANSLATION]
    if loads and not unloaded:
        yield "no translation_shifts_px: one or two unloaded shifts show, as strain that must be zero, how well distortion is corrected"
