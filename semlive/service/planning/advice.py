"""Advice on a planned experiment."""

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
"""With a cross of 8 px on the grid of the paper the distortion is as uncertain as allowed, with 12 px less."""
MIN_ROI_FRACTION = 0.8
"""Fraction of the image that a grid covers; 0.96 instead of 0.54 reduced the strain error of the correction by a third
(docs/validation/paper.md)."""
LONG_FRAME_S = 180.0
LONG_RUN_S = 6 * 3600.0
PAPER_HOLD_S = 30.0


def advice(config: Config, planned: ExperimentPlan) -> tuple[str, ...]:
    """Texts with a problem and its remedy each, most urgent first.

    Args:
        config: configuration of the run.
        planned: the other results of the plan.
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
    """Contradictions between test frame and configuration; none without a test frame."""
    scan, sem = planned.scan, config.sem
    if scan.vendor is None:
        return
    if sem.vendor not in (None, scan.vendor):
        yield f"sem.vendor is {sem.vendor}, but the test frame is from {scan.vendor}: its files never count as complete"
    ratio = 1e6 * scan.pixel_size_m / sem.pixel_size_um
    if abs(ratio - 1.0) > SAME_PIXEL:
        yield (
            f"sem.pixel_size_um is {sem.pixel_size_um:g}, the test frame's pixels are {1e6 * scan.pixel_size_m:.4g} um: "
            f"shifts would be {1.0 / ratio:.2g} times as large as planned; correct it"
        )


def _times(config: Config, planned: ExperimentPlan) -> Iterator[str]:
    hold, scan_s = config.plan().hold, planned.scan.frame_s
    needed_s = 2.0 * scan_s + config.sem.stable_for_s + config.sem.poll_s
    if hold.frame_timeout_s < needed_s:
        yield f"protocol.frame_timeout_s of {hold.frame_timeout_s:g} s is less than two scans: set it above {1.5 * needed_s:.0f}"
    if hold.hold_s < PAPER_HOLD_S and config.protocol.loads_n:
        yield f"after a hold of {hold.hold_s:g} s the specimen still relaxes: set protocol.hold_s to {PAPER_HOLD_S:g}, or adaptive_hold"
    if scan_s > LONG_FRAME_S:
        yield f"a frame takes {scan_s:.0f} s, during which the drift rate changes: scan faster and integrate frames"
    if planned.schedule.duration_s > LONG_RUN_S:
        yield f"the run takes {planned.schedule.duration_s / 3600:.1f} h: use fewer calibration shifts or a shorter dwell"
    if config.protocol.warm_up is None and config.estimate.method == "joint":
        yield "the run does not wait for slow drift: start 15 to 30 min after the beam is switched on, or set protocol.warm_up"
    if (
        config.protocol.loads_n
        and planned.schedule.steps
        and config.protocol.motion_timeout_s < max(step.motion_s for step in planned.schedule.steps)
    ):
        yield "protocol.motion_timeout_s is shorter than the longest ramp: increase it, or ramp_rate_n_s"


def _shifts(config: Config, planned: ExperimentPlan) -> Iterator[str]:
    shifts = np.array(config.protocol.calibration_shifts_px or [(0.0, 0.0)])
    span_x, span_y = np.ptp(shifts, axis=0)
    if min(span_x, span_y) < 1.0:
        missing = "both directions" if max(span_x, span_y) < 1.0 else f"the {'x' if span_x < 1.0 else 'y'} direction"
        refused = "" if config.estimate.accept_poor_calibration or not config.protocol.loads_n else ", and the specimen will not be loaded"
        yield f"no calibration shift in {missing}, so distortion cannot be determined{refused}: add shifts of 16 to 32 px along x and y"
    elif np.abs(shifts).max(axis=0).min() < SUFFICIENT_SHIFT_PX:
        yield (
            f"calibration shifts reach {np.abs(shifts)[:, 0].max():g} px along x and {np.abs(shifts)[:, 1].max():g} px along y: below "
            f"{SUFFICIENT_SHIFT_PX:g} px the calibration may be rejected before the first load; 16 to 32 px are usual"
        )
    elif len(config.protocol.calibration_shifts_px) < 7:
        yield f"{len(config.protocol.calibration_shifts_px)} calibration pairs are few: 9 to 17 shifts on a cross are usual"
    grid, scan, half = planned.grid, planned.scan, planned.grid.subset_px // 2
    max_shift = np.abs(shifts).max(axis=0)
    margin = (
        min(grid.x_px[0], scan.width_px - 1 - grid.x_px[-1]) - half,
        min(grid.y_px[0], scan.height_px - 1 - grid.y_px[-1]) - half,
    )
    if max_shift[0] > margin[0] or max_shift[1] > margin[1]:
        yield (
            f"shifts of up to {max_shift[0]:.0f} x {max_shift[1]:.0f} px move points out of the frame, whose margin is {margin[0]:.0f} x "
            f"{margin[1]:.0f} px: there they are missing; for strain up to the edge, use smaller shifts"
        )
    coverage = np.ptp(grid.x_px) * np.ptp(grid.y_px) / ((scan.width_px - 2.0 * half) * (scan.height_px - 2.0 * half))
    if scan.vendor is not None and coverage < MIN_ROI_FRACTION:
        yield (
            f"dic.roi_px excludes {100.0 * (1.0 - coverage):.0f} % of the possible points: all of them determine the distortion, "
            "so a roi up to the edge improves the strain in the middle, too"
        )


def _pattern(config: Config, planned: ExperimentPlan) -> Iterator[str]:
    quality = planned.quality
    if quality is None:
        yield "without --test-frame the noise of displacement and strain is unknown: scan one frame of the specimen and give it"
        return
    yield from quality.warnings
    if planned.recommended is not None and planned.recommended.choice.method == "global":
        yield (
            f"subsets are not sufficient for this frame: {planned.recommended.choice.reason}; use the global method, "
            "or improve the pattern, the contrast or the scan"
        )
    window = config.estimate.window_points
    gauge = next((option for option in planned.gauges if option.window_points == window), None)
    if gauge is not None and (sigma := max(gauge.sigma.exx, gauge.sigma.eyy)) > TARGET_STRAIN:
        longer = next((option for option in planned.gauges if max(option.sigma.exx, option.sigma.eyy) <= TARGET_STRAIN), None)
        wider = "" if longer is None else f"estimate.window_points: {longer.window_points} ({longer.vsg_px} px), or "
        times = (sigma / TARGET_STRAIN) ** 2
        yield f"one gauge of {gauge.vsg_px} px has a noise of {sigma:.1e}: set {wider}a dwell time {times:.1f} times as long"
    step, subset = planned.grid.step_px, planned.grid.subset_px
    if step > subset // 2:
        yield f"dic.step_px of {step} causes gaps between subsets of {subset} px: {max(subset // 4, 1)} resolves more at the same noise"
    elif step < subset // 12:
        yield f"dic.step_px of {step} uses the same pixels {subset // step} times: {max(subset // 8, 1)} is as good and faster"


def _steps(config: Config) -> Iterator[str]:
    loads = config.protocol.loads_n
    if loads and len(set(loads)) < 3:
        yield "fewer than three different loads: a line cannot be distinguished from a curve; add loads_n"
    if loads and config.specimen.area_mm2 is None:
        yield "specimen.area_mm2 is not set: there will be no stress and no elastic constants"
    if loads and config.limits is not None and config.limits.force_max_n > 1.5 * max(loads):
        yield f"limits.force_max_n of {config.limits.force_max_n:g} N is far above the largest load: {1.1 * max(loads):.0f} N stops earlier"
    unloaded = [step for step in config.plan().steps if step.phase is Phase.TRANSLATION]
    if loads and not unloaded:
        yield "no translation_shifts_px: add one or two unloaded shifts, whose strain must be zero, to test the correction of distortion"
