"""The report of a diagnosis as one self-contained HTML page."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

from semlive.data.diagnosis.effects import HeldOutMisfit, IdentifiedEffect
from semlive.data.diagnosis.verdict import UNDERRESOLVED, Diagnosis, DiagnosisFigureData
from semlive.diagnose.experiments.proposals import choose_proposal
from semlive.diagnose.simulation_comparison import Comparison
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


def diagnosis_html(
    name: str, diagnosis: Diagnosis, provenance: Sequence[tuple[str, str]] = (), comparison: Comparison | None = None
) -> str:
    """The verdict, effects with parameters and time courses, maps, held-out misfit, residual tests, evidence and next experiment.

    Args:
        name: name of the log.
        diagnosis: verdict of the diagnosis.
        provenance: origin of the report, as pairs of label and value.
        comparison: comparison with simulations without and with the effects; None: not simulated.
    """
    body = [f"<h1>{html.escape(name)}</h1>", f'<p class="soft">{html.escape(_verdict(diagnosis))}</p>']
    for effect in diagnosis.effects:
        body += [f"<h2>{html.escape(effect.name)}</h2>", _effect(effect), _course(diagnosis, effect.model_effect.name)]
    if diagnosis.gap is not None:
        body += ["<h2>Misfit on held-out pairs</h2>", _gap(diagnosis.gap)]
    if comparison is not None:
        body += ["<h2>Confirmation by simulation</h2>", comparison_section(comparison)]
    if diagnosis.figure_data is not None:
        body += ["<h2>Before and after</h2>", _maps(diagnosis.figure_data), "<h2>Effect on strain</h2>", _on_strain(diagnosis.figure_data)]
    body += ["<h2>Residual tests by domain, without effects</h2>", _where(diagnosis)]
    body += ["<h2>Evidence</h2>", _evidence(diagnosis.evidence)]
    if diagnosis.overlap:
        body += ["<h2>Overlap</h2>", _overlap(diagnosis)]
    if diagnosis.figure_data is not None:
        body += ["<h2>Residual</h2>", _residual(diagnosis.figure_data)]
    body += ["<h2>Rows</h2>", _rows(diagnosis), "<h2>Grey levels</h2>", _grey(diagnosis)]
    proposal = choose_proposal(diagnosis)
    if proposal is not None:
        between = ", ".join(proposal.candidates) or "no identified effect"
        about = f"{proposal.kind.value.replace('_', ' ')}, about {between}: {proposal.description}"
        body += [
            "<h2>Next experiment</h2>",
            f"<p>{html.escape(about)}. <code>semlive experiment propose</code> writes its configuration.</p>",
            _forecasts(diagnosis),
        ]
    body += ["<h2>Made from</h2>", _table(("", ""), provenance)]
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{html.escape(name)}</title>'
    return (
        f"<!doctype html>\n<html lang=en>\n<head>{head}\n<style>{STYLE}{_BARS}</style></head>\n<body>\n"
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def _forecasts(diagnosis: Diagnosis) -> str:
    menu = () if diagnosis.experiment is None else diagnosis.experiment.forecasts
    if not menu:
        return ""
    heads = ("experiment", "minutes of beam time", "ln odds", "ln odds per minute", "hardest pair of effects, the first assumed true")
    rows = [
        (
            forecast.summary,
            f"{forecast.minutes:.0f}",
            f"{forecast.log_odds:.1f}",
            f"{forecast.log_odds_per_minute:.2f}",
            f"{forecast.true}, {forecast.other}",
        )
        for forecast in menu
    ]
    return "<p>Expected results of experiments:</p>" + _table(heads, rows)


def _verdict(diagnosis: Diagnosis) -> str:
    text = diagnosis.outcome.value
    if diagnosis.effects:
        first = diagnosis.effects[0]
        text += f": {' + '.join(effect.name for effect in diagnosis.effects)}, at most {first.peak_px:.3f} px, p = {first.p_value:.3f}"
    if diagnosis.ambiguous:
        text += f"; equally likely: {', '.join(diagnosis.ambiguous)}"
    if diagnosis.group:
        text += f"; confounded group {diagnosis.group}"
    if diagnosis.gap is not None:
        text += f"; {100 * diagnosis.gap.closure:.0f} % of the misfit on held-out pairs explained"
    return text + "".join(f"; {name}: {UNDERRESOLVED[name]}" for name in diagnosis.coarse)


def _effect(effect: IdentifiedEffect) -> str:
    rows = [
        (
            parameter.name,
            f"{parameter.value:.4g}",
            f"{parameter.sigma:.2g}",
            f"{parameter.value / parameter.sigma:.1f}" if parameter.sigma > 0 else "",
            parameter.unit,
        )
        for parameter in effect.parameters
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


def _course(diagnosis: Diagnosis, name: str) -> str:
    """Profile of the effect over time or load; row effects are shown in the spectrum."""
    if non_map_effect(name) is not None:
        return ""  # the spectrum is a separate section
    profiles = () if diagnosis.figure_data is None else diagnosis.figure_data.profiles
    return "".join(image(effect_profile(profile), f"time course of {profile.name}") for profile in profiles if profile.name == name)


def _maps(pictures: DiagnosisFigureData) -> str:
    about = (
        "Held-out frames, in which only the motion of the specimen was fitted: means of blocks of points, in standard deviations of their "
        "noise, on one scale. Amplitudes and baseline are fitted to the other pairs."
    )
    return image(residual_maps(pictures), "maps before and after") + f'<p class="soft">{about}</p>'


def _on_strain(pictures: DiagnosisFigureData) -> str:
    rows = []
    for bias in pictures.on_strain:
        by = (
            ("", "")
            if bias.modulus_change is None or bias.poissons_ratio_change is None
            else (f"{100 * bias.modulus_change:+.3g} %", f"{bias.poissons_ratio_change:+.2g}")
        )
        rows.append((bias.name, f"{bias.exx:+.2e}", f"{bias.eyy:+.2e}", f"{bias.exy:+.2e}", *by))
    about = "Bias of the mean strain at the highest load by each effect, and change of the elastic constants by its correction."
    headings = ("effect", "exx", "eyy", "exy", "Young's modulus", "Poisson's ratio")
    return _table(headings, rows) + f'<p class="soft">{html.escape(about)}</p>'


def _residual(pictures: DiagnosisFigureData) -> str:
    own, sigma = pictures.frame_autocorrelation
    about = f"Whitened residuals with all effects; correlation of neighbouring frames {own:+.3f}, of noise alone 0 ± {sigma:.3f}."
    return image(residual_quantiles(pictures), "quantiles of the residual") + f'<p class="soft">{about}</p>'


def _rows(diagnosis: Diagnosis) -> str:
    rows = diagnosis.images.rows
    if rows is None:
        return f"<p>{html.escape(diagnosis.images.no_rows or 'Rows were not analysed.')}</p>"
    gap = "" if rows.gap is None else _gap(rows.gap)
    about = (
        f"{rows.pairs} pairs of {rows.rows} rows, uncertainty {rows.noise_px:.4f} px per row. Columns resolve frequencies that rows "
        "alone would alias; the disparity maps observe changes slower than a subset."
    )
    return image(row_spectrum(rows), "spectrum of the rows") + f'<p class="soft">{html.escape(about)}</p>' + gap


def _grey(diagnosis: Diagnosis) -> str:
    grey = diagnosis.images.grey
    if grey is None:
        return f"<p>{html.escape(diagnosis.images.no_grey or 'Grey levels were not analysed.')}</p>"
    unexplained = f" Unexplained: {grey.unexplained}." if grey.unexplained else ""
    about = (
        f"{grey.frames} frames in {grey.blocks} blocks fixed to the specimen, relative to the first pair: mean {grey.mean_levels:.0f}, "
        f"contrast {grey.contrast_levels:.0f} grey levels, at most {100 * grey.clipped:.2g} % black or white.{unexplained}"
    )
    rows = [(term.name, f"{term.value:.4g}", f"{term.sigma:.2g}", term.unit) for term in grey.noise]
    noise = _table(("variance a + b I of a pixel", "value", "sigma", "unit"), rows)
    return image(intensity_history(grey), "time series of grey levels") + f'<p class="soft">{html.escape(about)}</p>' + noise


def _gap(gap: HeldOutMisfit) -> str:
    low, high = gap.closure_interval
    bars = _misfit_bars((("before", gap.before_px), ("after", gap.after_px), ("noise alone", gap.floor_px)))
    return bars + f"<p>{100 * gap.closure:.0f} % explained, 95 % interval {100 * low:.0f} to {100 * high:.0f} %.</p>"


def _misfit_bars(sizes_px: Iterable[tuple[str, float]]) -> str:
    return _bars([(label, size_px, f"{size_px:.4f} px", True) for label, size_px in sizes_px])


def comparison_section(comparison: Comparison) -> str:
    """Misfit between measured and simulated maps without and with the effects, and the part that noise leaves."""
    maps, sizes = comparison.maps, comparison.sizes
    bars = _misfit_bars((("without the effects", maps.before_px), ("with the effects", maps.after_px), ("noise alone", maps.floor_px)))
    low, high = maps.interval
    text = (
        "The run was simulated twice, without and with the identified effects, by an implementation that shares no code with the "
        f"diagnosis. Measured minus simulated maps, {comparison.frames} frames of {comparison.blocks} blocks: the effects close "
        f"{100 * maps.closure:.0f} % of the misfit, 95 % interval {100 * low:.0f} to {100 * high:.0f} %. "
    )
    if sizes.measured_px > 0.0:
        text += (
            f"Smooth residual above noise: {sizes.measured_px:.4f} px measured, {sizes.simulated_px:.4f} px simulated with the effects. "
        )
    conclusion = "Confirmed" if comparison.confirmed else "Not confirmed"
    return f"{bars}<p>{html.escape(text)}<strong>{conclusion}.</strong></p>"


def _where(diagnosis: Diagnosis) -> str:
    rows = [(test.domain, f"{test.p_value:.3f}", f"{test.rms_px:.4f}") for test in sorted(diagnosis.where, key=lambda test: test.p_value)]
    return _table(("domain", "p, family-wise", "rms px"), rows)


def _evidence(evidence: Sequence[tuple[str, float]]) -> str:
    """The most likely effects; the baseline without a missing effect is at zero."""
    largest = sorted((*evidence, ("nothing", 0.0)), key=lambda entry: -entry[1])[:MAX_ROWS_SHOWN]
    return _bars([(name, max(size, 0.0), f"{size:.1f}", size >= SIGNIFICANT) for name, size in largest]) + (
        '<p class="soft">Logarithm of the Bayes factor against the model without a missing effect, before any effect was added.</p>'
    )


def _overlap(diagnosis: Diagnosis) -> str:
    """Effects that overlap with the first effect."""
    bars = _bars([(name, share, f"{100 * share:.0f} %", share >= OVERLAP_LIMIT) for name, share in diagnosis.overlap[:MAX_ROWS_SHOWN]])
    group = f" Confounded group {diagnosis.group}." if diagnosis.group else ""
    about = (
        f"Fraction of {diagnosis.effects[0].name}, after the fit of drift, distortion and motion, explained by each other effect with free "
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
    head = "".join(f"<th>{html.escape(heading)}</th>" for heading in headings)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><tr>{head}</tr>{body}</table></div>'
