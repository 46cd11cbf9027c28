"""The report of a diagnosis: every figure with a caption, numbers of the verdict in the text, and what is not known named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semlive.data.diagnosis.effects import DomainTest, HeldOutMisfit, IdentifiedEffect, ModelEffect, Outcome, ParameterEstimate
from semlive.data.diagnosis.misfit_reason import MisfitCriterion, MisfitReason
from semlive.data.diagnosis.verdict import (
    AdequacyTest,
    Diagnosis,
    DiagnosisFigureData,
    EffectProfile,
    ImageVerdicts,
    RunExtent,
    StrainBias,
)
from semlive.data.frame import ColumnSettings, FrameInfo
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.report.diagnosis_figures import MAX_RESIDUAL_MAPS
from semlive.report.diagnosis_report import diagnosis_report
from semlive.report.document.blocks import Bullets, Document, FigureBlock, Paragraph, Table

NAME = "magnification_drift"
FRAMES = tuple(range(20, 32))


def sourced(value: float) -> Sourced[float]:
    return Sourced(value, Provenance.FILE)


INFO = FrameInfo(
    3, "a.tif", "fei", 1024, 884, 60, ScanTiming(sourced(1e-4), sourced(0.107), sourced(94.6), Sourced(1, Provenance.FILE)),
    Sourced(1_795_688_108_158_812_000, Provenance.DERIVED), 0.01, sourced(2e-6), ColumnSettings(voltage_v=sourced(30e3)),
)  # fmt: skip


@pytest.fixture(scope="module")
def document() -> Document:
    x, y = (values.ravel() for values in np.meshgrid(np.linspace(100, 800, 8), np.linspace(100, 700, 6)))
    before = np.random.default_rng(0).standard_normal((len(FRAMES), x.size, 2))
    times = np.linspace(0.0, 3000.0, 10)
    profile = EffectProfile(NAME, "time", times, times / 3000, np.full(10, 0.1), times / 3000)
    bias = StrainBias(NAME, 1.5e-5, 1.4e-5, 0.0, 0.012, None)
    quantiles = np.stack((np.linspace(-2, 2, 9),) * 2, axis=1)
    pictures = DiagnosisFigureData(x, y, FRAMES, before, 0.5 * before, (profile,), (bias,), quantiles, (0.02, 0.05))
    effect = IdentifiedEffect(
        NAME, (ParameterEstimate("change", 1.234e-5, 3.2e-7, "1/h"),), 0.25, 55.0, 0.003, False, ModelEffect(NAME, (), 0.1)
    )
    verdict = Diagnosis(
        Outcome.IDENTIFIED, (effect,), (), "G1", None, HeldOutMisfit(0.02, 0.011, 0.01, 0.93, (0.9, 0.96), 12.0),
        (DomainTest("space", 0.2, 0.001), DomainTest("frame", 0.003, 0.01)), 0.01, ((NAME, 55.0), ("scan_shear_drift", 3.0)), (), pictures,
        (("magnification_frame_instability", 0.95),), (), ImageVerdicts(no_rows="The log holds no images."),
        RunExtent(3000.0, (1024, 884), (40, 80)),
    )  # fmt: skip
    return diagnosis_report("run", verdict, (("seed", "0"),), INFO)


def text_of(document: Document) -> str:
    parts: list[str] = []
    for block in (block for section in document.sections for block in section.blocks):
        match block:
            case Paragraph(text):
                parts.append(text)
            case Bullets(items):
                parts += items
            case Table():
                parts += [block.caption, *(" | ".join(row) for row in block.rows)]
            case FigureBlock():
                parts.append(f"{block.title}. {block.caption}")
            case _:
                pass
    return "\n".join(parts)


def test_each_figure_has_a_caption(document: Document) -> None:
    figures = [block for _, block in document.figures()]
    assert [block.key for block in figures] == [
        "profile-magnification-drift", "misfit", "residual-maps", "residual-quantiles", "evidence", "overlap",
    ]  # fmt: skip
    assert all(len(block.caption.split()) > 15 for block in figures)


def test_the_text_states_verdict_parameters_and_limits(document: Document) -> None:
    text = text_of(document)
    assert "IDENTIFIED: magnification_drift, at most 0.250 px, p = 0.003; confounded group G1; 93 % of the misfit" in text
    assert "change | (1.234 ± 0.032) · 10⁻⁵ | 38.6 | 1/h | on" in text
    assert "95 % interval 90 to 96 %" in text
    assert "40 of 80 pairs were used" in text
    assert text.count("The log holds no images.") == 2
    assert "acceleration voltage 30 kV, detector not recorded" in text


def test_an_unknown_states_what_failed_and_that_its_effects_are_not_found() -> None:
    jump = ParameterEstimate("first_frame", 7.0, 0.0, "")
    effect = IdentifiedEffect("jump_within_pair", (jump,), 0.25, 55.0, 0.003, False, ModelEffect("jump_within_pair", (), 0.1))
    reasons = (
        MisfitReason(MisfitCriterion.RESIDUAL, "field_that_grows", 21.04),
        MisfitReason(MisfitCriterion.TIME_COURSE, value=9.0),
        MisfitReason(MisfitCriterion.ADEQUACY, "space", 1e-9),
    )
    verdict = Diagnosis(
        Outcome.UNKNOWN, (effect,), (), None, None, None, (), 0.01, adequacy=AdequacyTest("space", 1e-9, 0.02, 0.01),
        closest=(("stage_yaw", 0.314),), unexplained=reasons,
    )  # fmt: skip
    document = diagnosis_report("run", verdict)
    text = text_of(document)

    assert "UNKNOWN: closest, not found: jump_within_pair" in text
    assert "Not explained: field_that_grows is significant in the residual of the maps, logarithm of its Bayes factor 21.0." in text
    assert "still not noise: test over space, p = 1e-09, 0.0200 px rms." in text
    assert text.count("not noise") == 1
    assert "Not explained: the time course differs" in text_of(diagnosis_report("run", replace(verdict, adequacy=None)))
    assert "none of them found, with the share of the gap that each closes alone: stage_yaw (31 %)." in text
    assert "first_frame | 7 |" in text
    assert "1 jump_within_pair (closest, not found)" in [section.title for section in document.sections]


def test_maps_are_in_micrometres_and_bounded(document: Document) -> None:
    figure = next(block.figure for _, block in document.figures() if block.key == "residual-maps")
    maps = [axes for axes in figure.axes if axes.collections and axes.get_title().startswith("frame")]
    assert len(maps) == MAX_RESIDUAL_MAPS
    assert [axes.get_title() for axes in maps][:: MAX_RESIDUAL_MAPS - 1] == [f"frame {FRAMES[0]}", f"frame {FRAMES[-1]}"]
    labels = {axes.get_xlabel() for axes in figure.axes}
    assert "x (µm)" in labels
    offsets = np.asarray(maps[0].collections[0].get_offsets())
    assert offsets[:, 0].max() == pytest.approx(1600.0)
