"""Section on the results: stress and strain, elastic constants, maps of chosen frames over the SEM image, and all frames in a table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from matplotlib.figure import Figure
from numpy.typing import NDArray

from semlive.data.results import FrameResult, RunResult
from semlive.data.settings import MEASURES
from semlive.report import figures, paper_figures
from semlive.report.document.blocks import Block, FigureBlock, Paragraph, Section, Table
from semlive.report.figures import MICRO, Field, colour_bar
from semlive.report.maps import colour_range, draw_map, label_lengths, map_sheet, scale_bar, visible_px
from semlive.report.run_data import RunData
from semlive.report.sections.protocol import MANY_ROWS
from semlive.report.sections.wording import fixed, measured
from semlive.report.style import PAGE_INCH

MapOf = Callable[[FrameResult], tuple[Field, NDArray]]
_COMPONENTS = ("exx", "eyy", "exy")


def results_section(data: RunData) -> Section:
    """Results.

    Args:
        data: of the run.
    """
    blocks: list[Block] = [Paragraph(elastic_text(data.result, data.settings.specimen.area_mm2))]
    blocks += _strain_figures(data)
    blocks += _map_figures(data)
    blocks.append(_frames_table(data.result))
    return Section("Results", tuple(blocks))


def elastic_text(result: RunResult, area_mm2: float | None) -> str:
    """Elastic constants with their standard uncertainties, or why there are none."""
    if result.elastic is None:
        reason = (
            "the cross-section is not recorded" if area_mm2 is None else "the run has no two different loads with strain that follows them"
        )
        return f"There are no elastic constants: {reason}."
    modulus, ratio = result.elastic.youngs_modulus_gpa, result.elastic.poissons_ratio
    text = (
        f"Young's modulus is E = {measured(modulus, 'GPa')} and Poisson's ratio ν = {measured(ratio)} (standard uncertainties). Both are "
        "slopes of lines with free intercepts through the load steps: strain over stress, weighted by the covariance of the mean strains."
    )
    if result.gage is not None:
        text += (
            f" By the strain gage E = {measured(result.gage.youngs_modulus_gpa, 'GPa')}; the strain by DIC over that of the gage is "
            f"{measured(result.gage.dic_over_gage)}."
        )
    return text


def _strain_figures(data: RunData) -> Iterator[Block]:
    result, specimen = data.result, data.settings.specimen
    figure = figures.stress_strain(result, specimen.area_mm2, specimen.loading_axis) if specimen.area_mm2 else None
    if figure is not None and result.elastic is not None:
        caption = (
            f"Mean strain over the field in each loaded frame along the load (axial) and across it (transverse). Lines: fit with E = "
            f"{measured(result.elastic.youngs_modulus_gpa, 'GPa')} and ν = {measured(result.elastic.poissons_ratio)}. Bars and bands: two "
            "standard uncertainties; where they cannot be seen they are smaller than the symbols. Bars of stress are the "
            "scatter of the load "
            "within a frame."
        )
        yield FigureBlock("stress-strain", "Stress over mean strain", caption, figure)
    figure = paper_figures.constants(result)
    if figure is not None:
        caption = "Young's modulus and Poisson's ratio with two standard uncertainties. Compare Fig. 14 of Sutton et al. (2007)."
        yield FigureBlock("fig14-constants", "Elastic constants", caption, figure)
    if result.gage is not None:
        caption = (
            f"Left: axial mean strain by DIC over that of the strain gage at each load step, with the fitted line of slope "
            f"{measured(result.gage.dic_over_gage)}. Right: distance from the line. Bars: two standard uncertainties of DIC."
        )
        yield FigureBlock("gage", "Comparison with the strain gage", caption, figures.gage_comparison(result.gage))
    figure = paper_figures.loaded_strain(result, specimen.area_mm2)
    if figure is not None:
        caption = (
            "Upper panel: mean strain over the field in the loaded frames; bars are two standard uncertainties. Lower panel: standard "
            "deviation over the field, which contains noise and inhomogeneous strain. Compare Fig. 13 of Sutton et al. (2007)."
        )
        yield FigureBlock("fig13-loaded", "Strain under load", caption, figure)


def _map_figures(data: RunData) -> Iterator[Block]:
    """Displacement and strain of the chosen frames."""
    chosen = [data.frame(number) for number in data.chosen]
    if not any(frame.displacement.valid.any() for frame in chosen):
        return
    scale, grid = data.scale, chosen[0].displacement.grid
    where = "over the SEM image of frame 0" if data.background is not None else "without image, because the log holds none"
    common = (
        "Each row has one colour range, which covers the inner 98 % of all its values and is extended to round numbers; points that were "
        "not measured are blank. Axes: position in frame 0; y points down."
    )
    means = "; ".join(
        f"frame {number}, {scale.factor * u:.4g} and {scale.factor * v:.4g} {scale.unit}"
        for number, (u, v) in zip(data.chosen, map(_mean_displacement, chosen), strict=True)
    )
    rows: list[tuple[str, MapOf]] = [
        (f"u along x ({scale.unit})", _moved("u_px", scale.factor)),
        (f"v along y ({scale.unit})", _moved("v_px", scale.factor)),
    ]
    caption = (
        f"Displacement from frame 0, corrected for drift and distortion, {where}. The mean over the field is subtracted from each map; the "
        f"means along x and y are: {means}. {common}"
    )
    yield FigureBlock("displacement-maps", "Displacement at chosen load steps", caption, _sheet(data, chosen, rows))
    gauge = chosen[-1].summary.gauge_sigma
    noise = (
        ""
        if gauge is None
        else f" The standard uncertainty of one gauge in the last map is {MICRO * gauge.exx:.0f} · 10⁻⁶ (exx) and "
        f"{MICRO * gauge.eyy:.0f} · 10⁻⁶ (eyy): smaller structures are noise."
    )
    caption = (
        f"{MEASURES[data.settings.estimate.strain.measure].capitalize()} relative to frame 0, tension positive, {where}; exy is tensor "
        f"shear. Virtual strain gauge {chosen[-1].summary.vsg_px:.0f} px = {scale.factor * chosen[-1].summary.vsg_px:.4g} "
        f"{scale.unit}, points "
        f"{grid.step_px} px apart.{noise} {common}"
    )
    strains: list[tuple[str, MapOf]] = [(f"{name} (10⁻³)", _strained(name)) for name in _COMPONENTS]
    yield FigureBlock("strain-maps", "Strain at chosen load steps", caption, _sheet(data, chosen, strains))


def _sheet(data: RunData, frames: list[FrameResult], rows: list[tuple[str, MapOf]]) -> Figure:
    """Maps of quantities (rows) in frames (columns), each quantity on one colour range."""
    scale, under, grid = data.scale, data.background, frames[0].displacement.grid
    left, right, lower, upper = visible_px(grid, under)
    figure, panels = map_sheet(len(rows), len(frames), (lower - upper) / (right - left), PAGE_INCH)
    for row, (label, map_of) in zip(panels, rows, strict=True):
        maps = [map_of(frame) for frame in frames]
        colours = colour_range([values[valid] for values, valid in maps])
        for axes, (values, valid) in zip(row, maps, strict=True):
            draw_map(axes, grid, values, valid, colours, scale, under)
        colour_bar(figure, row, colours, label)
    for axes, number in zip(panels[0], data.chosen, strict=True):
        axes.set_title(data.condition(number), fontsize=7.5)
    scale_bar(panels[0][0], scale)
    label_lengths(panels, scale)
    return figure


def _moved(name: str, factor: float) -> MapOf:
    def values(frame: FrameResult) -> tuple[Field, NDArray]:
        field, valid = getattr(frame.displacement, name), frame.displacement.valid
        return factor * (field - (field[valid].mean() if valid.any() else 0.0)), valid

    return values


def _strained(name: str) -> MapOf:
    return lambda frame: (1e3 * getattr(frame.strain, name), frame.strain.valid)


def _mean_displacement(frame: FrameResult) -> tuple[float, float]:
    moved = frame.displacement
    return (float(moved.u_px[moved.valid].mean()), float(moved.v_px[moved.valid].mean())) if moved.valid.any() else (0.0, 0.0)


def _frames_table(result: RunResult) -> Table:
    decisions = {decision.pair: decision for decision in result.decisions}
    rows = []
    for summary in result.summaries:
        decision = decisions[summary.frame // 2]
        load = fixed(decision.loads[summary.frame % 2].mean_n, 1) if decision.loads else ""
        strains = [
            f"{fixed(MICRO * getattr(summary.mean, name), 1)} ± {MICRO * getattr(summary.mean_sigma, name):.1f}" for name in _COMPONENTS
        ]
        rows.append((str(summary.frame), decision.step.phase.value, load, *strains, f"{MICRO * summary.sd.eyy:.0f}"))
    headings = ("frame", "phase", "load, N", "mean exx, 10⁻⁶", "mean eyy, 10⁻⁶", "mean exy, 10⁻⁶", "sd of eyy, 10⁻⁶")
    caption = "Mean strain of every accepted frame with its standard uncertainty, and its standard deviation over the field."
    return Table(caption, headings, tuple(rows), folded=len(rows) > MANY_ROWS)
