"""Appendix: settings, versions, files with checksums, alarms, and files that were not used."""

from __future__ import annotations

import re
from collections import Counter
from datetime import UTC, datetime
from importlib.metadata import version

import yaml

from semlive.data.grid import Grid
from semlive.data.settings import MEASURES, AnalysisSettings
from semlive.inputs.mask_file import mask_text
from semlive.report.document.blocks import Block, Listing, Paragraph, Section, Table
from semlive.report.run_data import RunData
from semlive.report.sections.wording import NOT_RECORDED
from semlive.service.config.overrides import as_keys
from semlive.service.log.alarms import Alarm, Alarms
from semlive.service.log.run_facts import LogFacts

_HEADINGS = ("time (UTC)", "level", "code", "where", "what", "action", "acknowledged")

_REASON_NUMBERS = re.compile(r"\d+(?:\.\d+)?")


def appendix_sections(data: RunData) -> tuple[Section, ...]:
    """Appendix with one section for each subject.

    Args:
        data: of the run.
    """
    grid = data.result.estimate.distortion.grid
    rows = tuple((key, str(value)) for key, value in as_keys(data.settings).items())
    settings = (
        Paragraph(settings_text(data.settings, grid)),
        Table("Every setting of the analysis.", ("key", "value"), rows, text=True, folded=True),
    )
    return (
        *fact_sections(data.facts),
        Section("Settings", (*settings, *configuration_blocks(data.facts))),
        Section("Files and versions", (*_file_blocks(data), versions_table(data.facts))),
    )


def fact_sections(facts: LogFacts) -> tuple[Section, ...]:
    """Alarms and files that were not used, for a run with or without results.

    Args:
        facts: facts of the log.
    """
    return Section("Alarms", alarm_blocks(facts.alarms)), Section("Refused frames", refused_blocks(facts))


def settings_text(settings: AnalysisSettings, grid: Grid) -> str:
    """Subset, grid, virtual strain gauge and measure of strain."""
    gauge = settings.estimate.window_points
    subset = f"Subset {grid.subset_px} px, step" if grid.subset_px else "Maps of another engine, step"
    return (
        f"{subset} {grid.step_px} px, virtual strain gauge {gauge} x {gauge} points = {grid.vsg_px(gauge)} px, "
        f"{MEASURES[settings.estimate.strain.measure]} relative to frame 0, tension positive."
    )


def refused_blocks(facts: LogFacts) -> tuple[Block, ...]:
    """Number of files that were not used by reason, and a list; with continuous scanning most frames are not part of a pair."""
    if not facts.refused:
        return (Paragraph(f"None of {facts.files} files." if facts.files else "The log contains none."),)
    count = Counter(_REASON_NUMBERS.sub("#", file.reason.removeprefix(file.name).strip()) for file in facts.refused)
    reasons = tuple((reason, str(times)) for reason, times in count.most_common())
    rows = tuple(("" if file.export is None else str(file.export), file.name, file.reason) for file in facts.refused)
    return (
        Paragraph(f"{len(facts.refused)} of {facts.files} files were not used."),
        Table("Reasons; # replaces a number.", ("reason", "files"), reasons, text=True),
        Table("Each file that was not used.", ("export", "file", "reason"), rows, text=True, folded=True),
    )


def configuration_blocks(facts: LogFacts) -> tuple[Block, ...]:
    """The configuration of the run, if the log has one."""
    if not facts.config:
        return ()
    config, dic = facts.config, facts.config.get("dic") or {}
    if dic.get("mask"):
        config = {**config, "dic": {**dic, "mask": mask_text(dic["mask"])}}
    return (Listing("The configuration of the run", yaml.safe_dump(config, sort_keys=False, allow_unicode=True)),)


def versions_table(facts: LogFacts) -> Table:
    """Versions of the programs of report and run."""
    rows = [("report made by semlive", version("semlive"))]
    rows += [(f"run made by {name}" if name == "semlive" else name, number) for name, number in (facts.versions or {}).items()]
    rows += [("computer", facts.host)] if facts.host else []
    rows += [("started or resumed", f"{facts.segments} times")] if facts.segments > 1 else []
    return Table("Versions.", ("what", "version"), tuple(rows), text=True)


def _file_blocks(data: RunData) -> tuple[Block, ...]:
    log = tuple((file.name, f"{file.size / 1e6:.1f}", file.sha256 or "not computed: the log is larger than 4 GB") for file in data.files)
    blocks: list[Block] = [Table("Files of the log.", ("file", "MB", "SHA-256"), log, text=True)] if log else []
    images = tuple(
        (str(2 * decision.pair + member), info.name, data.facts.sha256.get(info.export) or NOT_RECORDED)
        for decision in data.result.decisions
        for member, info in enumerate((decision.first, decision.second))
    )
    blocks.append(Table("Image files of the frames.", ("frame", "file", "SHA-256"), images, text=True, folded=True))
    return tuple(blocks)


def alarm_blocks(alarms: Alarms | None) -> tuple[Block, ...]:
    """Every alarm of a run, in order.

    Args:
        alarms: alarms of the log; None if the log was not read for alarms.
    """
    if alarms is None:
        return (Paragraph("Unknown: the log was not read for alarms."),)
    if not alarms.listed:
        return (Paragraph("None."),)
    omitted = f" The {alarms.forgotten} oldest acknowledged or repeated ones are not listed." if alarms.forgotten else ""
    summary = f"{len(alarms.listed) + alarms.forgotten} alarms, {len(alarms.open)} of them not acknowledged.{omitted}"
    return Paragraph(summary), Table("Alarms in the order of time.", _HEADINGS, tuple(_cells(alarm) for alarm in alarms.listed), text=True)


def _cells(alarm: Alarm) -> tuple[str, ...]:
    acknowledged = "no" if alarm.acknowledged_ns is None else f"{_utc(alarm.acknowledged_ns)} {alarm.acknowledged_by}".strip()
    return _utc(alarm.time_ns), alarm.level.value, alarm.code, alarm.where, alarm.text, alarm.action, acknowledged


def _utc(time_ns: int) -> str:
    # Milliseconds by integer arithmetic: a float of ns since 1970 has a resolution of a quarter of a microsecond, and rounds.
    seconds, rest_ns = divmod(time_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S}.{rest_ns // 1_000_000:03d}"
