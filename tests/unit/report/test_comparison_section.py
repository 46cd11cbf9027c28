"""Section of the diagnosis page that compares a run with simulations of it."""

from __future__ import annotations

import math
from pathlib import Path

from semlive.cli.after_run.confirmation import comparison_text, proof_json, proof_text
from semlive.data.strain import MeasuredValue
from semlive.diagnose.residual_channels import ChannelResidual
from semlive.diagnose.simulation_comparison import Comparison, MisfitReduction, Proof, SmoothPowerRatio
from semlive.report.document.blocks import FigureBlock, Paragraph, Table
from semlive.report.proof_section import proof_section

BEFORE, AFTER, NOISE = MeasuredValue(4.2, 0.31), MeasuredValue(1.05, 0.04), MeasuredValue(0.98, 0.02)
CHANNELS = (ChannelResidual("x", BEFORE, AFTER, NOISE), ChannelResidual("y_smooth", BEFORE, AFTER, NOISE))
NO_SMOOTH_RESIDUAL = SmoothPowerRatio(0.0, 0.004, 0.0, (0.0, math.inf))
CLOSED = Comparison(MisfitReduction(0.02, 0.011, 0.0108, 0.97, (0.8, 1.1)), NO_SMOOTH_RESIDUAL, 18, 221, CHANNELS)
OPEN = Comparison(
    MisfitReduction(0.02, 0.019, 0.0108, 0.14, (-0.1, 0.3)), SmoothPowerRatio(0.01, 0.002, 0.2, (0.1, 0.3)), 18, 221, CHANNELS
)


def parts(comparison: Comparison) -> tuple[str, FigureBlock, Table]:
    text, figure, table = proof_section(Proof(9, comparison.channels, ("tilt_with_load",), comparison)).blocks
    assert isinstance(text, Paragraph)
    assert isinstance(figure, FigureBlock)
    assert isinstance(table, Table)
    return text.text, figure, table


def test_the_page_shows_the_misfit_without_and_with_the_effects_and_that_of_noise() -> None:
    text, block, table = parts(CLOSED)
    assert text == "Confirmed. Added: tilt_with_load. Bound of the work: two simulated runs of 9 pairs each, as many as were measured."
    assert all(part in block.caption for part in ("97 %", "80 to 110 %", "18 frames of 221 blocks"))
    assert [label.get_text() for label in block.figure.axes[0].texts] == ["0.0200 px", "0.0110 px", "0.0108 px"]
    assert table.rows[0] == ("along x", "4.20 ± 0.31", "1.050 ± 0.040", "0.980 ± 0.020")
    assert [row[0] for row in table.rows] == ["along x", "along y, smooth part"]


def test_a_misfit_that_stays_open_is_not_confirmed() -> None:
    text, _, _ = parts(OPEN)
    assert text.startswith("Not confirmed.")
    assert "0.0100 px measured, 0.0020 px simulated" in text
    assert comparison_text(OPEN).startswith("not confirmed, by 18 maps of 221 blocks")


def test_the_object_and_the_text_contain_both_gaps() -> None:
    proof = Proof(9, CHANNELS, ("tilt_with_load",), CLOSED)
    found = proof_json(proof, Path("prove/diagnosis.html"))
    assert isinstance(found["proof"], dict)
    assert found["proof"]["confirmed"] is True
    assert found["residual"] == {
        "pairs": 9,
        "added": ["tilt_with_load"],
        "nothing_added": None,
        "channels": [
            {"channel": name, "before": sized(BEFORE), "after": sized(AFTER), "expected": sized(NOISE)} for name in ("x", "y_smooth")
        ],
        "page": "prove/diagnosis.html",
    }
    lines = proof_text(proof).splitlines()
    assert lines[0].startswith("simulation with tilt_with_load: confirmed")
    assert lines[-2] == "x: 4.200 +- 0.310 before, 1.050 +- 0.040 after, 0.980 +- 0.020 by noise alone, in units of the noise"


def sized(quantity: MeasuredValue) -> dict[str, float]:
    return {"value": quantity.value, "sigma": quantity.sigma}


def test_where_nothing_was_added_the_gap_is_shown_as_measured() -> None:
    proof = Proof(9, (ChannelResidual("x_smooth", BEFORE, None, NOISE),), reason="no effect was identified")
    text, table = proof_section(proof).blocks
    assert isinstance(text, Paragraph)
    assert isinstance(table, Table)
    assert text.text == ("Nothing was added and nothing was simulated: no effect was identified. The table shows the gap as measured.")
    assert table.rows == (("along x, smooth part", "4.20 ± 0.31", "nothing added", "0.980 ± 0.020"),)
    assert proof_json(proof, Path("a.html"))["proof"] is None
    assert proof_text(proof).splitlines() == [
        "nothing was added and nothing was simulated: no effect was identified; the gap as measured:",
        "x_smooth: 4.200 +- 0.310 before, 0.980 +- 0.020 by noise alone, in units of the noise",
    ]
