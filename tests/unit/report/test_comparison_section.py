"""Section of the diagnosis page that compares a run with simulations of it."""

from __future__ import annotations

import math

from semlive.cli.after_run.confirmation import comparison_json, comparison_text
from semlive.diagnose.simulation_comparison import Comparison, MisfitReduction, SmoothPowerRatio
from semlive.report.diagnosis_report import comparison_section
from semlive.report.document.blocks import FigureBlock, Paragraph

NO_SMOOTH_RESIDUAL = SmoothPowerRatio(0.0, 0.004, 0.0, (0.0, math.inf))
CLOSED = Comparison(MisfitReduction(0.02, 0.011, 0.0108, 0.97, (0.8, 1.1)), NO_SMOOTH_RESIDUAL, 18, 221)
OPEN = Comparison(MisfitReduction(0.02, 0.019, 0.0108, 0.14, (-0.1, 0.3)), SmoothPowerRatio(0.01, 0.002, 0.2, (0.1, 0.3)), 18, 221)


def parts(comparison: Comparison) -> tuple[str, FigureBlock]:
    text, figure = comparison_section(comparison).blocks
    assert isinstance(text, Paragraph)
    assert isinstance(figure, FigureBlock)
    return text.text, figure


def test_the_page_shows_the_misfit_without_and_with_the_effects_and_that_of_noise() -> None:
    text, block = parts(CLOSED)
    assert text == "Confirmed."
    assert all(part in block.caption for part in ("97 %", "80 to 110 %", "18 frames of 221 blocks"))
    assert [label.get_text() for label in block.figure.axes[0].texts] == ["0.0200 px", "0.0110 px", "0.0108 px"]


def test_a_misfit_that_stays_open_is_not_confirmed() -> None:
    text, _ = parts(OPEN)
    assert text.startswith("Not confirmed.")
    assert "0.0100 px measured, 0.0020 px simulated" in text
    assert comparison_text(OPEN).startswith("not confirmed, by 18 maps of 221 blocks")
    assert (comparison_json(OPEN)["confirmed"], comparison_json(CLOSED)["confirmed"]) == (False, True)
