"""The report of a diagnosis as one self-contained HTML page."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

from semlive.data.diagnosis.effects import HeldOutMisfit, IdentifiedEffect
from semlive.data.diagnosis.verdict import UNDERRESOLVED, Diagnosis, DiagnosisFigureData
from semlive.diagnose.experiments.proposals import choose_proposal
from semlive.model.effects.load_cell import LOAD_CELL_EFFECTS
from semlive.model.effects.stage import non_map_effect
from semlive.report.diagnosis_figures import effect_profile, intensity_history, residual_maps, residual_quantiles, row_spectrum
from semlive.report.page import STYLE, image

_BARS = """
.bars { display: grid; grid-template-columns: max-content 1fr max-content; gap: .15rem .7rem; align-items: center; }
.bars i { display: block; height: .8rem; background: var(--accent); border-radius: .2rem; min-width: 1px; }
.bars .minor { background: var(--line); }
"""
MAX_ROWS_SHOWN = 12
SIGNIFICANT = 7.0
OVERLAP_LIMIT = 0.9


def diagnosis_html(name: str, found: Diagnosis, provenance: Sequence[tuple[str, str]] = ()) -> str:
    """The verdict, effects with parameters and time courses, maps, held-out misfit, residual tests, evidence and next experiment.

    Args:
        name: name of the log.
        found: verdict of the diagnosis.
        provenance: origin of the report, as pairs of label and value.
    """
    body = [f"<h1>{html.escape(name)}</h1>", f'<p class="soft">{html.escape(_verdict(found))}</p>']
    for effect in found.effects:
        body += [f"<h2>{html.escape(effect.name)}</h2>", _effect(effect), _course(found, effect.model_effect.name)]
    if found.gap is not None:
        body += ["<h2>Misfit on held-out pairs</h2>", _gap(found.gap)]
    if found.figure_data is not None:
        body += ["<h2>Before and after</h2>", _maps(found.figure_data), "<h2>Effect on strain</h2>", _on_strain(found.figure_data)]
    body += ["<h2>Residual tests by domain, without effects</h2>", _where(found)]
    body += ["<h2>Evidence</h2>", _evidence(found.evidence)]
    if found.overlap:
        body += ["<h2>Overlap</h2>", _overlap(found)]
    if found.figure_data is not None:
        body += ["<h2>Residual</h2>", _residual(found.figure_data)]
    body += ["<h2>Rows</h2>", _rows(found), "<h2>Grey levels</h2>", _grey(found)]
    proposal = choose_proposal(found)
    if proposal is not None:
        between = ", ".join(proposal.candidates) or "no identified effect"
        about = f"{proposal.kind.value.replace('_', ' ')}, about {between}: {proposal.description}"
        body += [
            "<h2>Next experiment</h2>",
            f"<p>{html.escape(about)}. <code>semlive experiment propose</code> writes its configuration.</p>",
            _forecasts(found),
        ]
    body += ["<h2>Made from</h2>", _table(("", ""), provenance)]
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{html.escape(name)}</title>'
    return (
        f"<!doctype html>\n<html lang=en>\n<head>{head}\n<style>{STYLE}{_BARS}</style></head>\n<body>\n"
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def _forecasts(found: Diagnosis) -> str:
    menu = () if found.experiment is None else found.experiment.forecasts
    if not menu:
        return ""
    heads = ("experiment", "minutes of beam time", "ln odds", "ln odds per minute", "hardest pair of effects, the first assumed true")
    rows = [
        (one.summary, f"{one.minutes:.0f}", f"{one.log_odds:.1f}", f"{one.log_odds_per_minute:.2f}", f"{one.true}, {one.other}")
        for one in menu
    ]
    return "<p>Expected results of experiments:</p>" + _table(heads, rows)


def _verdict(found: Diagnosis) -> str:
    text = found.outcome.value
    if found.effects:
        first = found.effects[0]
        text += f": {' + '.join(one.name for one in found.effects)}, at most {first.peak_px:.3f} px, p = {first.p_value:.3f}"
    if found.ambiguous:
        text += f"; equally likely: {', '.join(found.ambiguous)}"
    if found.group:
        text += f"; confounded group {found.group}"
    if found.gap is not None:
        text += f"; {100 * found.gap.closure:.0f} % of the misfit on held-out pairs explained"
    return text + "".join(f"; {name}: {UNDERRESOLVED[name]}" for name in found.coarse)


def _effect(effect: IdentifiedEffect) -> str:
    rows = [
        (one.name, f"{one.value:.4g}", f"{one.sigma:.2g}", f"{one.value / one.sigma:.1f}" if one.sigma > 0 else "", one.unit)
        for one in effect.parameters
    ]
    attenuation = f"A correction would remove {_share(effect.strain_attenuation)} of a strain"
    if effect.modulus_bias is not None:
        by, sigma = effect.modulus_bias.value, effect.modulus_bias.sigma
        attenuation += f", and change Young's modulus by {100 * by:+.2g} ± {100 * sigma:.2g} %"
    text = f"{attenuation}: strain is not corrected for it." if effect.strain else f"{attenuation}."
    in_maps = non_map_effect(effect.model_effect.name) is None
    correction = "on" if (in_maps and not effect.strain) or effect.model_effect.name in LOAD_CELL_EFFECTS else "off"
    rows = [(*row, correction) for row in rows]
    return _table(("parameter", "value", "sigma", "value over sigma", "unit", "correction"), rows) + f"<p>{html.escape(text)}</p>"


def _share(attenuation: float) -> str:
    return f"{100 * attenuation:.2g} %" if attenuation < 0.995 else "all"


def _course(found: Diagnosis, name: str) -> str:
    """Profile of the effect over time or load; row effects are shown in the spectrum."""
    if non_map_effect(name) is not None:
        return ""  # the spectrum is a separate section
    profiles = () if found.figure_data is None else found.figure_data.profiles
    return "".join(image(effect_profile(one), f"time course of {one.name}") for one in profiles if one.name == name)


def _maps(pictures: DiagnosisFigureData) -> str:
    about = (
        "Held-out frames, in which only the motion of the specimen was fitted: means of blocks of points, in standard deviations of their "
        "noise, on one scale. Amplitudes and baseline are fitted to the other pairs."
    )
    return image(residual_maps(pictures), "maps before and after") + f'<p class="soft">{about}</p>'


def _on_strain(pictures: DiagnosisFigureData) -> str:
    rows = []
    for one in pictures.on_strain:
        by = (
            ("", "")
            if one.modulus_change is None or one.poissons_ratio_change is None
            else (f"{100 * one.modulus_change:+.3g} %", f"{one.poissons_ratio_change:+.2g}")
        )
        rows.append((one.name, f"{one.exx:+.2e}", f"{one.eyy:+.2e}", f"{one.exy:+.2e}", *by))
    about = "Bias of the mean strain at the highest load by each effect, and change of the elastic constants by its correction."
    headings = ("effect", "exx", "eyy", "exy", "Young's modulus", "Poisson's ratio")
    return _table(headings, rows) + f'<p class="soft">{html.escape(about)}</p>'


def _residual(pictures: DiagnosisFigureData) -> str:
    own, sigma = pictures.frame_autocorrelation
    about = f"Whitened residuals with all effects; correlation of neighbouring frames {own:+.3f}, of noise alone 0 ± {sigma:.3f}."
    return image(residual_quantiles(pictures), "quantiles of the residual") + f'<p class="soft">{about}</p>'


def _rows(found: Diagnosis) -> str:
    rows = found.rows
    if rows is None:
        return f"<p>{html.escape(found.rows_unavailable or 'Rows were not analysed.')}</p>"
    gap = "" if rows.gap is None else _gap(rows.gap)
    about = (
        f"{rows.pairs} pairs of {rows.rows} rows, uncertainty {rows.noise_px:.4f} px per row. Columns resolve frequencies that rows "
        "alone would alias; the disparity maps observe changes slower than a subset."
    )
    return image(row_spectrum(rows), "spectrum of the rows") + f'<p class="soft">{html.escape(about)}</p>' + gap


def _grey(found: Diagnosis) -> str:
    grey = found.grey
    if grey is None:
        return f"<p>{html.escape(found.intensity_unavailable or 'Grey levels were not analysed.')}</p>"
    unexplained = f" Unexplained: {grey.unexplained}." if grey.unexplained else ""
    about = (
        f"{grey.frames} frames in {grey.blocks} blocks fixed to the specimen, relative to the first pair: mean {grey.mean_levels:.0f}, "
        f"contrast {grey.contrast_levels:.0f} grey levels, at most {100 * grey.clipped:.2g} % black or white.{unexplained}"
    )
    rows = [(one.name, f"{one.value:.4g}", f"{one.sigma:.2g}", one.unit) for one in grey.noise]
    noise = _table(("variance a + b I of a pixel", "value", "sigma", "unit"), rows)
    return image(intensity_history(grey), "time series of grey levels") + f'<p class="soft">{html.escape(about)}</p>' + noise


def _gap(gap: HeldOutMisfit) -> str:
    low, high = gap.closure_interval
    sizes = (("before", gap.before_px), ("after", gap.after_px), ("noise alone", gap.floor_px))
    bars = _bars([(label, size, f"{size:.4f} px", True) for label, size in sizes])
    return bars + f"<p>{100 * gap.closure:.0f} % explained, 95 % interval {100 * low:.0f} to {100 * high:.0f} %.</p>"


def _where(found: Diagnosis) -> str:
    rows = [(one.domain, f"{one.p_value:.3f}", f"{one.rms_px:.4f}") for one in sorted(found.where, key=lambda one: one.p_value)]
    return _table(("domain", "p, family-wise", "rms px"), rows)


def _evidence(evidence: Sequence[tuple[str, float]]) -> str:
    """The most likely effects; the baseline without a missing effect is at zero."""
    largest = sorted((*evidence, ("nothing", 0.0)), key=lambda one: -one[1])[:MAX_ROWS_SHOWN]
    return _bars([(name, max(size, 0.0), f"{size:.1f}", size >= SIGNIFICANT) for name, size in largest]) + (
        '<p class="soft">Logarithm of the Bayes factor against the model without a missing effect, before any effect was added.</p>'
    )


def _overlap(found: Diagnosis) -> str:
    """Effects that overlap with the first effect."""
    bars = _bars([(name, share, f"{100 * share:.0f} %", share >= OVERLAP_LIMIT) for name, share in found.overlap[:MAX_ROWS_SHOWN]])
    group = f" Confounded group {found.group}." if found.group else ""
    about = (
        f"Fraction of {found.effects[0].name}, after the fit of drift, distortion and motion, that each other effect explains with free "
        f"amplitudes: effects above {100 * OVERLAP_LIMIT:.0f} % are hard to separate.{group}"
    )
    return bars + f'<p class="soft">{html.escape(about)}</p>'


def _bars(rows: Sequence[tuple[str, float, str, bool]]) -> str:
    largest = max((size for _, size, _, _ in rows), default=0.0) or 1.0
    cells = []
    for label, size, text, significant in rows:
        bar = f'<i class="{"" if significant else "minor"}" style="width: {100 * size / largest:.1f}%"></i>'
        cells.append(f"<span>{html.escape(label)}</span>{bar}<span>{text}</span>")
    return f'<div class="bars">{"".join(cells)}</div>'


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(one)}</th>" for one in headings)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(one)}</td>" for one in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><tr>{head}</tr>{body}</table></div>'
