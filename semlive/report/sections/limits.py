"""Section on limits: warnings of the estimate, what the uncertainty does not include, and what was not recorded."""

from __future__ import annotations

from semlive.data.experiment import Phase
from semlive.report.document.blocks import Block, Bullets, Paragraph, Section, Table
from semlive.report.run_data import RunData
from semlive.report.sections.summary import quality_verdict, warning_lines
from semlive.report.sections.wording import counted
from semlive.report.uncertainty_budget import uncertainty_budget

FEW_LOADS = 4
"""Number of loads below which the report states that the linearity is not tested: a parabola has three parameters."""


def budget_section(data: RunData) -> Section:
    """Uncertainty budget.

    Args:
        data: of the run.
    """
    text = (
        "Standard uncertainties (one standard deviation) from the noise of a single point to the elastic constants. Parts with the source "
        '"not included" must be added by the user.'
    )
    rows = tuple(uncertainty_budget(data.result, data.settings))
    return Section(
        "Uncertainty budget",
        (Paragraph(text), Table("Components of the uncertainty.", ("quantity", "standard uncertainty", "source"), rows, text=True)),
    )


def limits_section(data: RunData) -> Section:
    """Limits and warnings.

    Args:
        data: of the run.
    """
    warnings, remarks = warning_lines(data)
    blocks: list[Block] = [Paragraph(f"Verdict on the quality: {quality_verdict(data)}")]
    if warnings:
        blocks += [Paragraph("Warnings of the analysis:"), Bullets(tuple(warnings))]
    blocks += [Paragraph("What the stated uncertainties do not contain:"), Bullets(tuple(limits(data)))]
    if remarks:
        blocks += [Paragraph("Remarks of the analysis:"), Bullets(tuple(remarks))]
    return Section("Limits and warnings", tuple(blocks))


def limits(data: RunData) -> list[str]:
    """Limits of this run, one sentence or two each."""
    result, specimen, first = data.result, data.settings.specimen, data.first
    found = [
        "Translations of unknown size do not determine the magnification. An error of the pixel size changes positions and "
        "displacements in µm, not strain."
    ]
    found.append(
        "The affine part of the distortion is set to zero. It scales all strains by a common factor near 1 and causes no false strain."
    )
    if specimen.area_mm2 is not None and result.elastic is not None:
        found.append(
            f"The uncertainty of the cross-section ({specimen.area_mm2:g} mm²) and of the calibration of the load cell is not "
            f"included: one percent of either is one percent of E."
        )
    if result.elastic is not None:
        found.append(
            "Elastic constants assume a uniaxial stress that is equal over the field, and strain proportional to stress over "
            "all load steps."
        )
        loads = {decision.step.load_n for decision in result.decisions if decision.step.phase is Phase.TENSION}
        if len(loads) < FEW_LOADS:
            found.append(f"There are only {counted(len(loads), 'load')}: deviations from a straight line cannot be tested.")
    found.append(
        f"The start of each scan is known to {first.start_sigma_s:.3g} s (standard uncertainty), which is included; a wrong "
        f"assumption about "
        f"what the time in a file marks (here: {first.start_anchor}) is not."
    )
    found.append(
        "Effects that are not in the model (charging, focus, vibration, contamination) are not corrected. `semlive diagnose` "
        "tests for them."
    )
    if first.pixel_size_m.value <= 0:
        found.append("The pixel size is not recorded, so lengths are in px.")
    if data.background is None:
        found.append("The log holds no image of frame 0, so the images cannot be correlated again from it.")
    if data.series is None:
        found.append("The log holds no load.")
    if ((data.facts.config or {}).get("run") or {}).get("clock_file"):
        found.append("The time of the run came from the clock file of a simulator: images, loads and times are simulated, not measured.")
    return found
