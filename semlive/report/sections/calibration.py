"""Section on the calibration: quality of drift and distortion in figures, and the residual after the correction."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from semlive.data.results import RunResult
from semlive.report import figures, paper_figures
from semlive.report.document.blocks import Block, FigureBlock, Paragraph, Section
from semlive.report.run_data import RunData
from semlive.report.sections.wording import NOT_RECORDED, joined

PAPER = "M.A. Sutton et al., Experimental Mechanics 47 (2007) 789-804, doi:10.1007/s11340-007-9041-0"


def calibration_section(data: RunData) -> Section:
    """Calibration.

    Args:
        data: of the run.
    """
    paragraphs = (_method_text(data), _drift_text(data.result), _distortion_text(data.result), _quality_text(data.result))
    return Section("Calibration", (*(Paragraph(text) for text in paragraphs), *_figures(data)))


def _method_text(data: RunData) -> str:
    if data.settings.estimate.method == "sutton2007":
        return f"Drift and distortion were estimated by the published procedure ({PAPER})."
    return (
        "Drift and distortion were estimated jointly from all disparity maps: the drift as a spline over scan time, the distortion as a "
        f"spline over the image, both with a prior of unknown smoothness. The figures compare with those of {PAPER}."
    )


def _drift_text(result: RunResult) -> str:
    drift = result.estimate.drift
    span, rate = np.ptp(drift.drift_px, axis=0), float(np.max(np.hypot(*drift.rate_px_s.T)))
    rms = float(np.sqrt(np.mean(drift.sigma_px**2)))
    return (
        f"The drift spans {span[0]:.2f} px along x and {span[1]:.2f} px along y; its rate is at most {60 * rate:.3g} px/min. The standard "
        f"uncertainty of the drift within a frame is {rms:.4f} px (rms)."
    )


def _distortion_text(result: RunResult) -> str:
    field = result.estimate.distortion
    if not field.valid.any():
        return "The distortion was not determined: the translations cover no part of the field."
    x, y, sigma = (values[field.valid] for values in (field.ex_px, field.ey_px, field.sigma_px))
    largest = float(np.max(np.hypot(x, y)))
    rms_x, rms_y, rms = (float(np.sqrt(np.mean(values**2))) for values in (x, y, sigma))
    return (
        f"The distortion is at most {largest:.3f} px and {rms_x:.3f} px (x) and {rms_y:.3f} px (y) rms, without its affine "
        f"part. Its standard "
        f"uncertainty is {rms:.4f} px (rms over the field)."
    )


def _quality_text(result: RunResult) -> str:
    estimate, quality = result.estimate, result.estimate.calibration
    text = f"The noise of a point of a disparity map is {estimate.noise_floor_px:.4f} px (robust standard deviation of the residual)."
    if quality is None:
        text += f" How well the translations determine the distortion is {NOT_RECORDED}."
    else:
        x, y = quality.lever_px
        text += (
            f" The translations extend over {x:.1f} px along x and {y:.1f} px along y and determine the distortion in "
            f"{100 * quality.covered:.0f} % of the field."
        )
        if quality.wave_sigma_px is not None:
            along_x, along_y = quality.wave_sigma_px
            text += f" A wave of one period over the field has a standard uncertainty of {along_x:.4f} px (x) and {along_y:.4f} px (y)."
        text += f" The calibration is refused: {quality.refused}." if quality.refused else " The calibration is accepted."
    used = [term.name.replace("_", " ") for term in estimate.terms if term.included]
    tested = [term.name.replace("_", " ") for term in estimate.terms if not term.included]
    text += f" The model contains these further terms: {joined(used)}." if used else ""
    text += f" Tested and not significant: {joined(tested)}." if tested else ""
    return text


def _figures(data: RunData) -> Iterator[Block]:
    result, scale = data.result, data.scale
    over = "Axes: position in the image; y points down, as the rows are scanned."
    yield FigureBlock(
        "fig05-drift",
        "Drift over scan time",
        "Estimated drift of the image along both axes, relative to the start of frame 0. Dots: samples within accepted frames. Bands: two "
        "standard uncertainties, relative to the middle of each frame. Compare Fig. 5 of Sutton et al. (2007).",
        figures.drift_over_time(result),
    )
    yield FigureBlock(
        "fig01-drift-in-frames",
        "Drift within frames",
        f"Drift since the first row of a frame, over the time in the frame. One line for each frame, at most {paper_figures.MAX_CURVES} "
        "frames spread over the run; pale lines are early frames, dark lines late ones. Compare Fig. 1 of Sutton et al. (2007).",
        paper_figures.drift_within_frames(result),
    )
    yield FigureBlock(
        "fig10-drift-field",
        "Drift over the field of one frame",
        "Drift since the first row at the time at which each point was scanned, for the middle frame of the run. Points of one image are "
        f"displaced differently because they are scanned one after the other. {over} Compare Fig. 10 of Sutton et al. (2007).",
        paper_figures.drift_over_field(result, scale),
    )
    yield FigureBlock(
        "fig11-distortion",
        "Distortion of the raster",
        "Distance of each pixel from its place in an ideal raster, on one colour range for both components. The best affine map "
        "is removed, "
        f"because unknown translations do not determine it. Points outside the calibrated area are blank. {over} Compare Fig. 11 of Sutton "
        "et al. (2007).",
        figures.distortion_fields(result, scale),
    )
    yield from _residual_figures(data, over)
    yield from _translation_figures(data, over)


def _residual_figures(data: RunData, over: str) -> Iterator[Block]:
    result, scale = data.result, data.scale
    pair = paper_figures.middle_pair(result)
    figure = paper_figures.pair_residual(data.frame(2 * pair), data.frame(2 * pair + 1), scale)
    if figure is not None:
        caption = (
            f"Corrected displacement of frame {2 * pair + 1} minus that of frame {2 * pair}, between which the specimen was not moved: "
            f"noise, and drift that the estimate does not contain. Left and middle: maps. Right: their histograms. {over} "
            f"Compare Fig. 6 of "
            "Sutton et al. (2007)."
        )
        yield FigureBlock("fig06-pair", "Residual in a pair", caption, figure)
    count = len(paper_figures.residual_frames(result))
    figure = paper_figures.distortion_residual(result, data.frame, scale)
    if figure is not None:
        edge_px = paper_figures.SMOOTHED_POINTS * result.estimate.distortion.grid.step_px
        caption = (
            f"Mean over {count} unloaded frames and over squares of {edge_px} px of the corrected displacement, without its best plane: "
            f"distortion that the correction does not remove. Right: standard uncertainty of the distortion. {over} Compare "
            f"Fig. 7 of Sutton "
            "et al. (2007)."
        )
        yield FigureBlock("fig07-left", "Distortion that remains after correction", caption, figure)


def _translation_figures(data: RunData, over: str) -> Iterator[Block]:
    result, window = data.result, data.settings.estimate.window_points
    figure = paper_figures.translation_path(result)
    if figure is not None:
        caption = (
            "Commanded and measured positions of the specimen in the unloaded pairs, relative to the first pair. Bars: two standard "
            "uncertainties, drift during the motion included. Distances between both are errors of the stage, of the pixel size or of the "
            "angle between stage and image, and do not enter the strain. Compare Fig. 15 of Sutton et al. (2007)."
        )
        yield FigureBlock("fig15-path", "Translation path", caption, figure)
    figure = paper_figures.false_strain_figure(result, window, data.scale)
    if figure is not None:
        caption = (
            f"Strain that a translation of {paper_figures.TRANSLATED_PX:g} px would seem to cause if the distortion were not "
            f"corrected, for "
            f"the virtual strain gauge of {data.result.estimate.distortion.grid.vsg_px(window)} px. {over} Compare Fig. 16 of "
            f"Sutton et al. "
            "(2007)."
        )
        yield FigureBlock("fig16-false-strain", "False strain without correction", caption, figure)
    figure = paper_figures.unloaded_strain(result)
    if figure is not None:
        caption = (
            "Upper panel: mean strain over the field in the unloaded frames, where the true strain is zero; bars are two standard "
            "uncertainties. Lower panel: standard deviation over the field, for the virtual strain gauge of the run. Compare Fig. 12 of "
            "Sutton et al. (2007)."
        )
        yield FigureBlock("fig12-unloaded", "Strain without load", caption, figure)
