"""A diagnosis as one HTML page that needs no other file and no network."""

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
.bars .quiet { background: var(--line); }
"""
MAX_ROWS_SHOWN = 12
SIGNIFICANT = 7.0
OVERLAP_LIMIT = 0.9


def diagnosis_html(name: str, found: Diagnosis, provenance: Sequence[tuple[str, str]] = ()) -> str:
    """The verdict, effects with parameters and courses, maps before and after, gap, where model and data disagree, evidence, strain, next.

    Args:
        name: of the log.
        found: the verdict.
        provenance: what it was made from, as pairs of words.
    """
    body = [f"<h1>{html.escape(name)}</h1>", f'<p class="soft">{html.escape(_verdict(found))}</p>']
    for effect in found.effects:
        body += [f"<h2>{html.escape(effect.name)}</h2>", _effect(effect), _course(found, effect.model_effect.name)]
    if found.gap is not None:
        body += ["<h2>Gap on held-out pairs</h2>", _gap(found.gap)]
    if found.figure_data is not None:
        body += ["<h2>Before and after</h2>", _maps(found.figure_data), "<h2>Effect on strain</h2>", _on_strain(found.figure_data)]
    body += ["<h2>Where model and data disagree, before</h2>", _where(found)]
    body += ["<h2>Evidence</h2>", _evidence(found.evidence)]
    if found.overlap:
        body += ["<h2>Overlap</h2>", _overlap(found)]
    if found.figure_data is not None:
        body += ["<h2>What is left</h2>", _left(found.figure_data)]
    body += ["<h2>Rows</h2>", _rows(found), "<h2>Grey levels</h2>", _grey(found)]
    proposal = choose_proposal(found)
    if proposal is not None:
        between = ", ".join(proposal.candidates) or "nothing that has a name"
        about = f"{proposal.kind.value.replace('_', ' ')}, about {between}: {proposal.description}"
        body += [
            "<h2>Next experiment</h2>",
            f"<p>{html.escape(about)}. <code>semlive experiment propose</code> writes its configuration.</p>",
            _foretold(found),
        ]
    body += ["<h2>Made from</h2>", _table(("", ""), provenance)]
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{html.escape(name)}</title>'
    return (
        f"<!doctype html>\n<html lang=en>\n<head>{head}\n<style>{STYLE}{_BARS}</style></head>\n<body>\n"
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def _foretold(found: Diagnosis) -> str:
    menu = () if found.experiment is None else found.experiment.forecasts
    if not menu:
        return ""
    heads = ("experiment", "minutes of beam time", "ln odds", "ln odds a minute", "hardest to tell apart, the first being true")
    told = [
        (one.summary, f"{one.minutes:.0f}", f"{one.log_odds:.1f}", f"{one.log_odds_per_minute:.2f}", f"{one.true}, {one.other}")
        for one in menu
    ]
    return "<p>What experiments are expected to decide:</p>" + _table(heads, told)


def _verdict(found: Diagnosis) -> str:
    said = found.outcome.value
    if found.effects:
        first = found.effects[0]
        said += f": {' + '.join(one.name for one in found.effects)}, at most {first.peak_px:.3f} px, p = {first.p_value:.3f}"
    if found.ambiguous:
        said += f"; would do as well: {', '.join(found.ambiguous)}"
    if found.group:
        said += f"; confounded group {found.group}"
    if found.gap is not None:
        said += f"; {100 * found.gap.closure:.0f} % of the gap on held-out pairs closed"
    return said + "".join(f"; {name}: {UNDERRESOLVED[name]}" for name in found.coarse)


def _effect(effect: IdentifiedEffect) -> str:
    rows = [
        (one.name, f"{one.value:.4g}", f"{one.sigma:.2g}", f"{one.value / one.sigma:.1f}" if one.sigma > 0 else "", one.unit)
        for one in effect.parameters
    ]
    eaten = f"A correction would take {_share(effect.strain_attenuation)} of a strain away"
    if effect.modulus_bias is not None:
        by, sigma = effect.modulus_bias.value, effect.modulus_bias.sigma
        eaten += f", and change Young's modulus by {100 * by:+.2g} ± {100 * sigma:.2g} %"
    said = f"{eaten}: strain is not corrected for it." if effect.strain else f"{eaten}."
    in_maps = non_map_effect(effect.model_effect.name) is None
    taken = "on" if (in_maps and not effect.strain) or effect.model_effect.name in LOAD_CELL_EFFECTS else "off"
    rows = [(*row, taken) for row in rows]
    return _table(("parameter", "value", "sigma", "value over sigma", "unit", "correction"), rows) + f"<p>{html.escape(said)}</p>"


def _share(eaten: float) -> str:
    return f"{100 * eaten:.2g} %" if eaten < 0.995 else "all"


def _course(found: Diagnosis, name: str) -> str:
    """The effect in its own domain: frames over time or load, or the spectrum of the rows."""
    if non_map_effect(name) is not None:
        return ""  # the spectrum has a section of its own
    profiles = () if found.figure_data is None else found.figure_data.profiles
    return "".join(image(effect_profile(one), f"course of {one.name}") for one in profiles if one.name == name)


def _maps(pictures: DiagnosisFigureData) -> str:
    about = (
        "Frames that nothing was fitted on but how the specimen lay in them: means of blocks of points, in standard deviations of their "
        "noise, all on one scale. Amplitudes and baseline are those of the other pairs."
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
    about = "What each effect adds to the mean strain at the highest load, and by how much a correction for it would change the constants."
    headings = ("effect", "exx", "eyy", "exy", "Young's modulus", "Poisson's ratio")
    return _table(headings, rows) + f'<p class="soft">{html.escape(about)}</p>'


def _left(pictures: DiagnosisFigureData) -> str:
    own, sigma = pictures.frame_autocorrelation
    about = f"Whitened residuals with all effects; correlation of neighbouring frames {own:+.3f}, of noise alone 0 ± {sigma:.3f}."
    return image(residual_quantiles(pictures), "quantiles of what is left") + f'<p class="soft">{about}</p>'


def _rows(found: Diagnosis) -> str:
    rows = found.rows
    if rows is None:
        return f"<p>{html.escape(found.rows_unavailable or 'Rows were not looked at.')}</p>"
    gap = "" if rows.gap is None else _gap(rows.gap)
    about = (
        f"{rows.pairs} pairs of {rows.rows} rows, each known to {rows.noise_px:.4f} px. Columns tell frequencies apart that rows alone "
        "would alias; what is slower than a subset is the maps' business."
    )
    return image(row_spectrum(rows), "spectrum of the rows") + f'<p class="soft">{html.escape(about)}</p>' + gap


def _grey(found: Diagnosis) -> str:
    grey = found.grey
    if grey is None:
        return f"<p>{html.escape(found.intensity_unavailable or 'Grey levels were not looked at.')}</p>"
    left = f" Left without a law: {grey.unexplained}." if grey.unexplained else ""
    about = (
        f"{grey.frames} frames in {grey.blocks} blocks that follow the specimen, against the first pair: mean {grey.mean_levels:.0f}, "
        f"contrast {grey.contrast_levels:.0f} grey levels, at most {100 * grey.clipped:.2g} % black or white.{left}"
    )
    rows = [(one.name, f"{one.value:.4g}", f"{one.sigma:.2g}", one.unit) for one in grey.noise]
    noise = _table(("variance a + b I of a pixel", "value", "sigma", "unit"), rows)
    return image(intensity_history(grey), "courses of grey levels") + f'<p class="soft">{html.escape(about)}</p>' + noise


def _gap(gap: HeldOutMisfit) -> str:
    low, high = gap.closure_interval
    sizes = (("before", gap.before_px), ("after", gap.after_px), ("noise alone", gap.floor_px))
    bars = _bars([(label, size, f"{size:.4f} px", True) for label, size in sizes])
    return bars + f"<p>{100 * gap.closure:.0f} % closed, 95 % interval {100 * low:.0f} to {100 * high:.0f} %.</p>"


def _where(found: Diagnosis) -> str:
    rows = [(one.domain, f"{one.p_value:.3f}", f"{one.rms_px:.4f}") for one in sorted(found.where, key=lambda one: one.p_value)]
    return _table(("domain", "p, family-wise", "rms px"), rows)


def _evidence(evidence: Sequence[tuple[str, float]]) -> str:
    """The likeliest names; nothing missing is at zero."""
    loudest = sorted((*evidence, ("nothing", 0.0)), key=lambda one: -one[1])[:MAX_ROWS_SHOWN]
    return _bars([(name, max(size, 0.0), f"{size:.1f}", size >= SIGNIFICANT) for name, size in loudest]) + (
        '<p class="soft">Logarithm of the Bayes factor against nothing missing, before any effect was added.</p>'
    )


def _overlap(found: Diagnosis) -> str:
    """What could be taken for the first effect."""
    bars = _bars([(name, share, f"{100 * share:.0f} %", share >= OVERLAP_LIMIT) for name, share in found.overlap[:MAX_ROWS_SHOWN]])
    group = f" Confounded group {found.group}." if found.group else ""
    about = (
        f"Share of {found.effects[0].name}, of what drift, distortion and motion leave of it, that each other name could take over if it "
        f"had any size: from {100 * OVERLAP_LIMIT:.0f} % on the two are hard to tell apart.{group}"
    )
    return bars + f'<p class="soft">{html.escape(about)}</p>'


def _bars(rows: Sequence[tuple[str, float, str, bool]]) -> str:
    largest = max((size for _, size, _, _ in rows), default=0.0) or 1.0
    cells = []
    for label, size, text, loud in rows:
        bar = f'<i class="{"" if loud else "quiet"}" style="width: {100 * size / largest:.1f}%"></i>'
        cells.append(f"<span>{html.escape(label)}</span>{bar}<span>{text}</span>")
    return f'<div class="bars">{"".join(cells)}</div>'


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(one)}</th>" for one in headings)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(one)}</td>" for one in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><tr>{head}</tr>{body}</table></div>'
