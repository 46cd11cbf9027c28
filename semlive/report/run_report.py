"""The report of a run as a document in the form of a paper: methods, results, uncertainty, limits."""

from __future__ import annotations

from semlive.report.document.blocks import Document, Paragraph, Section
from semlive.report.run_data import RunData
from semlive.report.sections.appendix import appendix_sections, configuration_blocks, fact_sections, versions_table
from semlive.report.sections.calibration import calibration_section
from semlive.report.sections.instrument import instrument_section
from semlive.report.sections.limits import budget_section, limits_section
from semlive.report.sections.protocol import protocol_section
from semlive.report.sections.results import results_section
from semlive.report.sections.summary import summary_section
from semlive.report.sections.wording import NOT_RECORDED, utc_date
from semlive.report.style import publication_style
from semlive.service.log.run_facts import LogFacts

_NUMBERED = (instrument_section, protocol_section, calibration_section, results_section, budget_section, limits_section)


def run_report(data: RunData) -> Document:
    """The report of a run.

    Args:
        data: of the run.
    """
    with publication_style():
        main = [section(data) for section in _NUMBERED]
        numbered = [Section(f"{at} {section.title}", section.blocks) for at, section in enumerate(main, start=1)]
        appendix = [
            Section(f"Appendix {letter}: {section.title}", section.blocks)
            for letter, section in zip("ABCDEF", appendix_sections(data), strict=False)
        ]
        specimen = data.settings.specimen.name or f"specimen {NOT_RECORDED}"
        subtitle = (
            f"Strain by digital image correlation in a scanning electron microscope: {specimen}, {utc_date(data.first.start_time_ns.value)}"
        )
        return Document(data.name, subtitle, (summary_section(data), *numbered, *appendix))


def report_without_results(name: str, why: str, facts: LogFacts) -> Document:
    """The report of a run without results: alarms, rejected frames, configuration and versions.

    Args:
        name: the run's name.
        why: reason for missing results, one sentence.
        facts: further facts of the log.
    """
    settings = Section("Settings", configuration_blocks(facts))
    reason = Section("Summary", (Paragraph(f"No results: {why}"),))
    return Document(name, "A run without results", (reason, *fact_sections(facts), settings, Section("Versions", (versions_table(facts),))))
