"""The report: one self-contained HTML page."""

from __future__ import annotations

import base64
import html

from matplotlib.figure import Figure

from semlive.data.results import RunResult
from semlive.data.series import LoadSeries
from semlive.data.settings import AnalysisSettings
from semlive.report import figures

_STYLE = """
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
.scroll { overflow-x: auto; }
"""


def report_html(name: str, result: RunResult, series: LoadSeries | None, settings: AnalysisSettings) -> str:
    """A whole run as one HTML page that needs no other file and no network.

    Args:
        name: the run's name.
        result: every frame corrected with the newest estimate.
        series: load as sampled, or None without a load frame.
        settings: what the run was analysed with.
    """
    area_mm2, axis = settings.specimen.area_mm2, settings.specimen.loading_axis
    last = result.frames[-1]
    curve = figures.stress_strain(result, area_mm2, axis) if area_mm2 is not None else None
    sections = [
        ("Load", figures.load_over_time(series, result)) if series is not None and series.time_ns.size else None,
        ("Drift", figures.drift_over_time(result)),
        ("Distortion", figures.distortion_fields(result)),
        ("Strain", figures.strain_maps(last, f"frame {last.summary.frame}, virtual strain gauge {last.summary.vsg_px:.0f} px")),
        ("Stress and strain", curve) if curve is not None else None,
        ("Strain gage", figures.gage_comparison(result.gage)) if result.gage is not None else None,
    ]
    body = [f"<h1>{html.escape(name)}</h1>", f'<p class="soft">{html.escape(settings.specimen.name)}</p>', _key_figures(result)]
    body += [f"<h2>{title}</h2>\n{_image(figure, title)}" for title, figure in filter(None, sections)]
    body += ["<h2>Frames</h2>", _frames_table(result), "<h2>Notes</h2>", _notes(result), "<h2>Settings</h2>", _settings(settings)]
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{html.escape(name)} - semlive</title><style>{_STYLE}</style></head>\n<body>\n" + "\n".join(body) + "\n</body></html>\n"
    )


def _image(figure: Figure, title: str) -> str:
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
    for frame in result.frames:
        summary = frame.summary
        decision = decisions[summary.frame // 2]
        load = f"{decision.loads[summary.frame % 2].mean_n:.1f}" if decision.loads else ""
        strains = "".join(
            f"<td>{getattr(summary.mean, c) * 1e6:.1f} ± {getattr(summary.mean_sigma, c) * 1e6:.1f}</td>" for c in ("exx", "eyy", "exy")
        )
        first = f"<td>{summary.frame}</td><td>{decision.step.phase.value}</td><td>{load}</td>"
        rows.append(f"<tr>{first}{strains}<td>{summary.sd.eyy * 1e6:.0f}</td></tr>")
    return f'<div class="scroll"><table>{head}{"".join(rows)}</table></div>'


def _notes(result: RunResult) -> str:
    if not result.notes:
        return "<p>None.</p>"
    return "<ul>" + "".join(f"<li>{html.escape(note)}</li>" for note in result.notes) + "</ul>"


def _settings(settings: AnalysisSettings) -> str:
    dic, gauge = settings.dic, settings.estimate.window_points
    vsg_px = (gauge - 1) * dic.step_px + dic.subset_px
    return (
        f"<p>Subset {dic.subset_px} px, step {dic.step_px} px, virtual strain gauge {gauge} x {gauge} points = {vsg_px} px, "
        f"engineering small strain relative to frame 0, tension positive.</p>"
    )
