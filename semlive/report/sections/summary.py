"""Summary of a run: the result in one sentence, a verdict on its quality, and the main figures."""

from __future__ import annotations

from semlive import pipeline
from semlive.data.notes import NoteLevel
from semlive.report.document.blocks import Block, KeyFigures, Paragraph, Section
from semlive.report.run_data import RunData
from semlive.report.sections.results import elastic_text
from semlive.report.sections.wording import counted, joined, measured
from semlive.service.log.alarms import AlarmLevel


def summary_section(data: RunData) -> Section:
    """Summary.

    Args:
        data: of the run.
    """
    result = data.result
    entries = [("pairs", str(len(result.decisions))), ("noise of a point", f"{result.estimate.noise_floor_px:.4f} px")]
    if result.gage is not None:
        entries.insert(0, ("strain, DIC over gage", measured(result.gage.dic_over_gage)))
    if result.elastic is not None:
        entries.insert(0, ("Poisson's ratio ν", measured(result.elastic.poissons_ratio)))
        entries.insert(0, ("Young's modulus E", measured(result.elastic.youngs_modulus_gpa, "GPa")))
    last = result.summaries[-1]
    text = elastic_text(result, data.settings.specimen.area_mm2)
    if result.elastic is None:
        text += (
            f" The mean strain of the last frame ({last.frame}) is exx = {1e6 * last.mean.exx:.0f}, eyy = {1e6 * last.mean.eyy:.0f} · 10⁻⁶."
        )
    blocks: tuple[Block, ...] = (KeyFigures(tuple(entries)), Paragraph(text), Paragraph(f"Quality: {quality_verdict(data)}"))
    return Section("Summary", blocks)


def quality_verdict(data: RunData) -> str:
    """Whether the result can be used, with the reasons."""
    refused = pipeline.calibration_refusal(data.result, data.settings)
    if refused is not None:
        return f"not usable under load. The calibration is refused: {refused}."
    warnings = sum(message.startswith("WARNING") for message in data.result.messages)
    alarms = () if data.facts.alarms is None else data.facts.alarms.open
    dangers = sum(alarm.level is AlarmLevel.DANGER for alarm in alarms)
    reasons = [counted(warnings, "warning")] if warnings else []
    reasons += [f"{counted(dangers, 'alarm')} of danger not acknowledged"] if dangers else []
    coarse = data.result.estimate.calibration is not None and bool(data.result.estimate.calibration.refused)
    reasons += ["a calibration that was accepted by the configuration only"] if coarse else []
    if reasons:
        return f"usable with reservations: {joined(reasons)} (see Limits and warnings)."
    return "no warning and no open alarm of danger. The limits of the method apply (see Limits and warnings)."


def warning_lines(data: RunData) -> tuple[list[str], list[str]]:
    """Warnings, and remarks for information, of estimate and strain gage."""
    prefix = f"{NoteLevel.WARNING.value.upper()}: "
    messages = [message.replace("+-", "±") for message in data.result.messages]
    warnings = [message.removeprefix(prefix) for message in messages if message.startswith(prefix)]
    remarks = [message for message in messages if not message.startswith(prefix)]
    return warnings, remarks
