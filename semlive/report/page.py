"""The report: one self-contained HTML page."""

from __future__ import annotations

import base64
import html
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import version

import yaml
from matplotlib.figure import Figure

from semlive.data.grid import Grid
from semlive.data.loading import LoadSeries
from semlive.data.results import RunResult
from semlive.data.settings import MEASURES, AnalysisSettings
from semlive.report import figures
from semlive.report.alarms import alarms_html
from semlive.report.sections import sections
from semlive.report.uncertainty_budget import uncertainty_budget
from semlive.service.config.overrides import as_keys
from semlive.service.log.run_facts import LogFacts

_REASON_NUMBERS = re.compile(r"\d+(?:\.\d+)?")
STYLE = """
:root { color-scheme: light dark;
  --ink: #0f172a; --paper: #ffffff; --soft: #64748b; --line: #e2e8f0; --accent: #2563eb; }
@media (prefers-color-scheme: dark) { :root { --ink: #e2e8f0; --paper: #0f172a; --soft: #94a3b8; --line: #334155; --accent: #60a5fa; } }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
  max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: 0; } h2 { font-size: 1.1rem; margin-top: 2.2rem; border-bottom: 1px solid var(--line); }
.soft { color: var(--soft); } .key { display: flex; flex-wrap: wrap; gap: 1rem; margin: 1.2rem 0; }
.key div { border: 1px solid var(--line); border-radius: .6rem; padding: .6rem 1rem; }
.key b { display: block; font-size: 1.25rem; color: var(--accent); }
img { max-width: 100%; border-radius: .5rem; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; width: 100%; }
th, td { text-align: right; padding: .2rem .6rem; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; }
.scroll { overflow-x: auto; } .text th, .text td { text-align: left; vertical-align: top; }
pre { overflow-x: auto; font-size: .85rem; } details { margin: .6rem 0; }
"""


def report_html(
    name: str,
    result: RunResult,
    series: LoadSeries | None,
    settings: AnalysisSettings,
    facts: LogFacts | None = None,
    progress: Callable[[int, int], object] = lambda *_: None,
) -> str:
    """The report of a run as one self-contained HTML page.

    Args:
        name: the run's name.
        result: every frame corrected with the newest estimate.
        series: load as sampled, or None without a load frame.
        settings: settings of the analysis.
        facts: further facts of the log; None omits rejected frames, configuration and versions.
        progress: called with the number of drawn figures and of all figures.
    """
    facts = facts or LogFacts()
    body = [f"<h1>{html.escape(name)}</h1>", f'<p class="soft">{html.escape(settings.specimen.name)}</p>', _key_figures(result)]
    drawn = tuple(sections(result, series, settings))
    for number, section in enumerate(drawn, start=1):
        about = f'<p class="soft">{html.escape(section.caption)}</p>'
        body += [f"<h2>{html.escape(section.title)}</h2>", image(section.figure, section.title), about]
        progress(number, len(drawn))
    body += [
        '<p class="soft">Figures are numbered as in M.A. Sutton et al., <i>Experimental Mechanics</i> 47 (2007) 789-804, '
        "doi:10.1007/s11340-007-9041-0.</p>",
        "<h2>Uncertainty budget</h2>",
        _table(("what", "standard uncertainty", "from"), uncertainty_budget(result, settings)),
        "<h2>Frames</h2>",
        _frames_table(result),
        "<h2>Alarms</h2>",
        alarms_html(facts.alarms),
        "<h2>Refused frames</h2>",
        refused_html(facts),
        "<h2>Notes</h2>",
        _notes(result),
        "<h2>Settings</h2>",
        settings_html(settings, result.estimate.distortion.grid),
        _all_settings(settings, facts),
        "<h2>Versions</h2>",
        _versions(facts),
    ]
    return _whole(name, body)


def unanalysed_html(name: str, why: str, facts: LogFacts) -> str:
    """The report of a run without results: alarms, rejected frames, configuration and versions.

    Args:
        name: the run's name.
        why: reason for missing results, one sentence.
        facts: further facts of the log.
    """
    body = [
        f"<h1>{html.escape(name)}</h1>",
        f"<p>No results: {html.escape(why)}</p>",
        "<h2>Alarms</h2>",
        alarms_html(facts.alarms),
        "<h2>Refused frames</h2>",
        refused_html(facts),
        "<h2>Settings</h2>",
        _configuration(facts),
        "<h2>Versions</h2>",
        _versions(facts),
    ]
    return _whole(name, body)


def _whole(name: str, body: Sequence[str]) -> str:
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{html.escape(name)} - semlive</title><style>{STYLE}</style></head>\n<body>\n" + "\n".join(body) + "\n</body></html>\n"
    )


def image(figure: Figure, title: str) -> str:
    """A figure embedded in the page."""
    data = base64.b64encode(figures.png(figure)).decode("ascii")
    return f'<img alt="{html.escape(title)}" src="data:image/png;base64,{data}">'


def _key_figures(result: RunResult) -> str:
    boxes = []
    if result.elastic is not None:
        modulus, ratio = result.elastic.youngs_modulus_gpa, result.elastic.poissons_ratio
        boxes.append(("Young's modulus", f"{modulus.value:.2f} ± {modulus.sigma:.2f} GPa"))
        boxes.append(("Poisson's ratio", f"{ratio.value:.4f} ± {ratio.sigma:.4f}"))
    if result.gage is not None:
        modulus, agreement = result.gage.youngs_modulus_gpa, result.gage.dic_over_gage
        boxes.append(("Young's modulus by the strain gage", f"{modulus.value:.2f} ± {modulus.sigma:.2f} GPa"))
        boxes.append(("strain, DIC over gage", f"{agreement.value:.4f} ± {agreement.sigma:.4f}"))
    boxes.append(("pairs", str(len(result.decisions))))
    boxes.append(("noise floor", f"{result.estimate.noise_floor_px:.4f} px"))
    return '<div class="key">' + "".join(f"<div>{html.escape(label)}<b>{value}</b></div>" for label, value in boxes) + "</div>"


def _frames_table(result: RunResult) -> str:
    decisions = {decision.pair: decision for decision in result.decisions}
    head = "<tr><th>frame</th><th>phase</th><th>load N</th><th>exx 1e-6</th><th>eyy 1e-6</th><th>exy 1e-6</th><th>sd eyy 1e-6</th></tr>"
    rows = []
    for summary in result.summaries:
        decision = decisions[summary.frame // 2]
        load = f"{decision.loads[summary.frame % 2].mean_n:.1f}" if decision.loads else ""
        strains = "".join(
            f"<td>{getattr(summary.mean, c) * 1e6:.1f} ± {getattr(summary.mean_sigma, c) * 1e6:.1f}</td>" for c in ("exx", "eyy", "exy")
        )
        first = f"<td>{summary.frame}</td><td>{decision.step.phase.value}</td><td>{load}</td>"
        rows.append(f"<tr>{first}{strains}<td>{summary.sd.eyy * 1e6:.0f}</td></tr>")
    return f'<div class="scroll"><table>{head}{"".join(rows)}</table></div>'


def _notes(result: RunResult) -> str:
    if not result.messages:
        return "<p>None.</p>"
    return "<ul>" + "".join(f"<li>{html.escape(note)}</li>" for note in result.messages) + "</ul>"


def settings_html(settings: AnalysisSettings, grid: Grid) -> str:
    """Settings of subset, grid and virtual strain gauge."""
    gauge = settings.estimate.window_points
    subset = f"Subset {grid.subset_px} px, step" if grid.subset_px else "Maps of another engine, step"
    return (
        f"<p>{subset} {grid.step_px} px, virtual strain gauge {gauge} x {gauge} points = {grid.vsg_px(gauge)} px, "
        f"{MEASURES[settings.estimate.strain.measure]} relative to frame 0, tension positive.</p>"
    )


def refused_html(facts: LogFacts) -> str:
    """Number of rejected files by reason, with an expandable list; with continuous scanning most frames are not part of a pair."""
    if not facts.refused:
        return f"<p>None of {facts.files} files.</p>" if facts.files else "<p>The log contains none.</p>"
    count = Counter(_REASON_NUMBERS.sub("#", file.reason.removeprefix(file.name).strip()) for file in facts.refused)
    text = f"<p>{len(facts.refused)} of {facts.files} files were not used.</p>"
    reasons = _table(("reason", "files"), [(reason, str(times)) for reason, times in count.most_common()])
    rows = [("" if file.export is None else str(file.export), file.name, file.reason) for file in facts.refused]
    return f"{text}{reasons}<details><summary>each of them</summary>{_table(('export', 'file', 'reason'), rows)}</details>"


def _all_settings(settings: AnalysisSettings, facts: LogFacts) -> str:
    rows = [(key, str(value)) for key, value in as_keys(settings).items()]
    details = f"<details><summary>every setting of the analysis</summary>{_table(('key', 'value'), rows)}</details>"
    return details + _configuration(facts)


def _configuration(facts: LogFacts) -> str:
    if not facts.config:
        return ""
    text = html.escape(yaml.safe_dump(facts.config, sort_keys=False, allow_unicode=True))
    return f"<details><summary>the run's configuration</summary><pre>{text}</pre></details>"


def _versions(facts: LogFacts) -> str:
    rows = [("report made by semlive", version("semlive"))]
    rows += [(f"run made by {name}" if name == "semlive" else name, number) for name, number in (facts.versions or {}).items()]
    rows += [("computer", facts.host)] if facts.host else []
    rows += [("started or resumed", f"{facts.segments} times")] if facts.segments > 1 else []
    return _table(("what", "is"), rows)


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(heading)}</th>" for heading in headings)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><tr>{head}</tr>{body}</table></div>'
