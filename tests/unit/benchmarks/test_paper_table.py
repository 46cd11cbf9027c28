"""The comparison with the paper: where a figure is reached, what is pooled, and where the page is written."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from paper import write_between
from sidebyside.facts import PAPER, STATED_WINDOW
from sidebyside.field import PAPER_POINTS, on_papers_points
from sidebyside.measure import FIELDS, GaugeRow, PhaseFigures, RunFigures
from sidebyside.table import Row, correction_share, reached_at

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.drift import DistortionField
from semlive.data.grid import Grid
from semlive.errors import BadInput

PAGE = Path(__file__).parents[3] / "docs" / "validation" / "paper.md"


def line(vsg_px: int, strain: float) -> GaugeRow:
    return GaugeRow((vsg_px - 43) // 5 + 1, vsg_px, dict.fromkeys(FIELDS, strain), dict.fromkeys(FIELDS, 2 * strain), {}, 0.1)


def test_the_gauge_that_reaches_a_figure_is_interpolated() -> None:
    curve = tuple(line(length, 4.0 / length**2) for length in (50, 100, 200, 400))
    assert reached_at(curve, 4.0 / 141.0**2) == "141 px"
    assert reached_at(curve, 1.0) == "≤ 50 px"
    assert reached_at(curve, 1e-9) == "> 400 px"
    assert curve[0].ratio("exx") == 0.5


def test_a_curve_that_rises_again_has_not_reached_a_figure_before() -> None:
    assert reached_at((line(50, 1e-4), line(100, 3e-4), line(200, 1e-4)), 2e-4).removesuffix(" px").isdigit()
    assert int(reached_at((line(50, 1e-4), line(100, 3e-4), line(200, 1e-4)), 2e-4).split()[0]) > 100


def test_correction_share_weights_frames_equally_and_sums_components() -> None:
    def phase(frames: int, exx: float, eyy: float) -> PhaseFigures:
        share = {**dict.fromkeys(FIELDS, 0.0), "exx": exx, "eyy": eyy}
        row = GaugeRow(STATED_WINDOW, 83, dict.fromkeys(FIELDS, 1.0), dict.fromkeys(FIELDS, 1.0), share, 0.1)
        return PhaseFigures(np.zeros((frames, 3)), np.zeros((frames, 3)), np.zeros((frames, 3)), np.zeros((frames, 3)), (row,))

    run = SimpleNamespace(phases={"calibration": phase(3, 5e-5, 1e-5), "tension": phase(1, 1e-5, 7e-5)})
    share = correction_share(cast(RunFigures, run))
    assert share["exx"] == pytest.approx(np.sqrt((3 * 5e-5**2 + 1e-5**2) / 4))
    assert share["eyy"] == pytest.approx(np.sqrt((3 * 1e-5**2 + 7e-5**2) / 4))
    assert share["exy"] == 0.0


def test_what_is_compared_are_the_papers_points() -> None:
    wide = Grid(36, 31, 5, 191, 165, 43)
    x, y = wide.mesh()
    sigma = np.ones(wide.shape)
    observed = DisparityMap(0, 3, wide, x, y, sigma, sigma, sigma, np.full(wide.shape, PoiStatus.CONVERGED, np.uint8))

    part = on_papers_points(observed)
    assert (part.grid, part.reference, part.current) == (PAPER_POINTS, 0, 3)
    np.testing.assert_array_equal((part.u_px, part.v_px), PAPER_POINTS.mesh())
    assert part.status.shape == part.grid.shape
    assert (part.grid.x_px[-1], part.grid.y_px[-1]) == (846, 696)
    assert on_papers_points(part).grid == PAPER_POINTS


@pytest.mark.parametrize("grid", [Grid(38, 31, 5, 191, 165, 43), Grid(101, 101, 5, 149, 120, 43), Grid(106, 101, 5, 150, 120, 43)])
def test_a_field_without_the_papers_points_is_compared_as_it_is(grid: Grid) -> None:
    nothing, measured = np.zeros(grid.shape), np.ones(grid.shape, np.bool_)
    field = DistortionField(grid, nothing, nothing, nothing, measured)
    assert on_papers_points(field) is field


def test_a_section_is_replaced_and_nothing_else() -> None:
    text = "a\n<!-- one: begin -->\nold\n<!-- one: end -->\nb\n<!-- two: begin -->\n<!-- two: end -->\n"
    new = write_between(text, "one", "new")
    assert new == text.replace("old", "new")
    assert write_between(new, "one", "new") == new
    with pytest.raises(BadInput, match="lacks <!-- three: begin -->"):
        write_between(text, "three", "new")


def test_a_missed_bar_reports_so() -> None:
    assert Row("a", "b", "c", "≤ 1", held=False).markdown() == "| a | b | c | ≤ 1 **missed** | – |"
    assert Row("a", "b", "c").markdown() == "| a | b | c | – | – |"


@pytest.mark.checkout
def test_the_page_holds_every_experiment() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for scenario in PAPER:
        section = text.partition(f"<!-- {scenario}: begin -->")[2].partition(f"<!-- {scenario}: end -->")[0]
        assert "| Young's modulus |" in section
        assert (PAGE.parent / f"{scenario.replace('_', '-')}.svg").is_file()
