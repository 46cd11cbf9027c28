"""The report of a diagnosis as a document: verdict, instrument, effects, misfit on held-out pairs, tests, evidence, limits."""

from __future__ import annotations

from collections.abc import Sequence

from semlive.data.diagnosis.effects import HeldOutMisfit, IdentifiedEffect, Outcome
from semlive.data.diagnosis.verdict import SETTLING_LAWS, UNDERRESOLVED, Diagnosis, DiagnosisFigureData, settling_text
from semlive.data.frame import FrameInfo
from semlive.diagnose.experiments.proposals import choose_proposal
from semlive.diagnose.simulation_comparison import Proof
from semlive.model.effects import EFFECT_CLASSES
from semlive.model.effects.load_cell import LOAD_CELL_EFFECTS
from semlive.model.effects.stage import non_map_effect
from semlive.report.diagnosis_figures import (
    bars,
    effect_profile,
    intensity_history,
    misfit_bars,
    residual_maps,
    residual_quantiles,
    row_spectrum,
)
from semlive.report.document.blocks import Block, Bullets, Document, FigureBlock, Paragraph, Section, Table
from semlive.report.maps import ImageScale
from semlive.report.proof_section import proof_section
from semlive.report.sections.instrument import instrument_rows, microscope_text
from semlive.report.sections.wording import with_sigma
from semlive.report.style import publication_style

MAX_ROWS_SHOWN = 12
SIGNIFICANT = 7.0
OVERLAP_LIMIT = 0.9
_OUTCOMES = {
    Outcome.NONE: "No effect is missing in the model that these data could show.",
    Outcome.IDENTIFIED: "The effects below are missing in the model, and no other explanation is comparable.",
    Outcome.AMBIGUOUS: "An effect is missing in the model; several effects explain the data equally well.",
    Outcome.UNKNOWN: "An effect is missing in the model that is not in the dictionary.",
    Outcome.REJECTED: "The most likely effect does not explain the held-out pairs.",
}


def diagnosis_report(
    name: str,
    diagnosis: Diagnosis,
    provenance: Sequence[tuple[str, str]] = (),
    first: FrameInfo | None = None,
    proof: Proof | None = None,
) -> Document:
    """The report of a diagnosis.

    Args:
        name: name of the log.
        diagnosis: verdict of the diagnosis.
        provenance: origin of the report, as pairs of label and value.
        first: metadata of frame 0 for instrument and pixel size; None omits the instrument, and lengths are in px.
        proof: confirmation by simulation; None: not requested.
    """
    size_m = 0.0 if first is None else first.pixel_size_m.value
    scale = ImageScale(1e6 * size_m if size_m > 0 else None)
    with publication_style():
        parts = [Section("Verdict", (Paragraph(_OUTCOMES[diagnosis.outcome]), Paragraph(_verdict(diagnosis)), *_not_explained(diagnosis)))]
        if first is not None:
            table = Table(
                "Settings of the microscope, as recorded for frame 0.", ("quantity", "value", "source"), instrument_rows(first), text=True
            )
            parts.append(Section("Instrument", (Paragraph(microscope_text(first)), table)))
        parts += [_effect(effect, diagnosis) for effect in diagnosis.effects]
        if diagnosis.gap is not None:
            parts.append(Section("Misfit on held-out pairs", _gap(diagnosis.gap, "misfit")))
        if proof is not None:
            parts.append(proof_section(proof))
        if diagnosis.figure_data is not None:
            parts += _with_figures(diagnosis, diagnosis.figure_data, scale)
        parts += [_tests(diagnosis), Section("Row shifts", _rows(diagnosis)), Section("Grey levels", _grey(diagnosis))]
        parts += [
            *_next(diagnosis),
            _limits(diagnosis),
            Section("Made from", (_table("Origin of this report.", ("what", "value"), provenance),)),
        ]
    numbered = (Section(f"{at} {part.title}", part.blocks) for at, part in enumerate(parts[1:], start=1))
    return Document(name, "Diagnosis: where data and model of a run disagree", (parts[0], *numbered))


def _table(caption: str, headings: Sequence[str], rows: Sequence[Sequence[str]], *, text: bool = True) -> Table:
    return Table(caption, tuple(headings), tuple(tuple(row) for row in rows), text=text)


def _verdict(diagnosis: Diagnosis) -> str:
    text = diagnosis.outcome.value
    if diagnosis.effects:
        first = diagnosis.effects[0]
        state = ": closest, not found: " if diagnosis.outcome is Outcome.UNKNOWN else ": "
        text += f"{state}{' + '.join(effect.name for effect in diagnosis.effects)}, at most {first.peak_px:.3f} px, p = {first.p_value:.3f}"
    if diagnosis.ambiguous:
        text += f"; equally likely: {', '.join(diagnosis.ambiguous)}"
    if diagnosis.group:
        text += f"; confounded group {diagnosis.group}"
    if diagnosis.gap is not None:
        text += f"; {100 * diagnosis.gap.closure:.0f} % of the misfit on held-out pairs explained"
    return text + "".join(f"; {name}: {UNDERRESOLVED[name]}" for name in diagnosis.coarse) + "."


def _not_explained(diagnosis: Diagnosis) -> tuple[Block, ...]:
    """What the effects do not explain, and the closest effects of an UNKNOWN; empty if there is nothing."""
    lines = [f"Not explained: {reason.text}." for reason in diagnosis.further_misfit]
    test = diagnosis.adequacy
    if test is not None and not test.passed:
        lines.append(
            f"With all effects the residual of the maps is still not noise: test over {test.domain}, p = {test.p_value:.1g}, "
            f"{test.rms_px:.4f} px rms."
        )
    if diagnosis.closest:
        shares = ", ".join(f"{name} ({100 * share:.0f} %)" for name, share in diagnosis.closest)
        lines.append(f"Closest effects, none of them found, with the share of the gap that each closes alone: {shares}.")
    return (Bullets(tuple(lines)),) if lines else ()


def _effect(effect: IdentifiedEffect, diagnosis: Diagnosis) -> Section:
    name = effect.model_effect.name
    correction = "on" if (non_map_effect(name) is None and not effect.strain) or name in LOAD_CELL_EFFECTS else "off"
    discrete = next((family.discrete_parameters for family in EFFECT_CLASSES if family.name == name), ())
    rows = [
        (
            parameter.name,
            " or ".join(with_sigma(*value) for value in ((parameter.value, parameter.sigma), *parameter.alternatives))
            if parameter.name not in discrete
            else f"{parameter.value:g}",
            f"{parameter.value / parameter.sigma:.1f}" if parameter.sigma > 0 else "",
            parameter.unit,
            correction,
        )
        for parameter in effect.parameters
    ]
    headings = ("parameter", "value ± standard uncertainty", "value over uncertainty", "unit", "correction")
    blocks: list[Block] = [_table(f"Parameters of {effect.name}.", headings, rows), Paragraph(_attenuation(effect))]
    profiles = () if diagnosis.figure_data is None or non_map_effect(name) is not None else diagnosis.figure_data.profiles
    for profile in profiles:
        if profile.name == name:
            caption = (
                f"Amplitude of {name} in each frame, at the place where its displacement field is largest, over "
                f"{'the start of the frame' if profile.abscissa == 'time' else 'the load'}. Dots: fitted to the maps of each "
                f"frame alone, all other "
                "effects subtracted, with two standard uncertainties. Line: the effect with its fitted parameters."
            )
            blocks.append(FigureBlock(f"profile-{name.replace('_', '-')}", f"Amplitude of {name}", caption, effect_profile(profile)))
    title = f"{effect.name} (closest, not found)" if diagnosis.outcome is Outcome.UNKNOWN else effect.name
    return Section(title, tuple(blocks))


def _attenuation(effect: IdentifiedEffect) -> str:
    share = f"{100 * effect.strain_attenuation:.2g} %" if effect.strain_attenuation < 0.995 else "all"
    text = f"A correction would remove {share} of a strain"
    if effect.modulus_bias is not None:
        by, sigma = effect.modulus_bias.value, effect.modulus_bias.sigma
        text += f", and change Young's modulus by {100 * by:+.2g} ± {100 * sigma:.2g} %"
    return f"{text}: strain is not corrected for it." if effect.strain else f"{text}."


def _gap(gap: HeldOutMisfit, key: str) -> tuple[Block, ...]:
    low, high = gap.closure_interval
    figure = misfit_bars(gap.before_px, gap.after_px, gap.floor_px)
    caption = (
        "Root mean square residual of pairs that were not used to fit the effects, without and with them, and what noise alone would give. "
        f"The effects explain {100 * gap.closure:.0f} % of the misfit, 95 % interval {100 * low:.0f} to {100 * high:.0f} %."
    )
    return (FigureBlock(key, "Misfit on held-out pairs", caption, figure),)


def _with_figures(diagnosis: Diagnosis, pictures: DiagnosisFigureData, scale: ImageScale) -> list[Section]:
    caption = (
        "Held-out frames, in which only the motion of the specimen was fitted: residual along x (upper two rows) and y (lower two rows) "
        "without (before) and with (after) the effects. Each square is the mean of a block of points, in standard deviations of "
        "its noise, on "
        "one colour range. Amplitudes and baseline are fitted to the other pairs. Axes: position in the image; y points down."
    )
    maps = FigureBlock("residual-maps", "Residual maps before and after", caption, residual_maps(pictures, scale))
    own, sigma = pictures.frame_autocorrelation
    caption = (
        "Quantiles of the whitened residuals with all effects over those of a normal distribution; on the line they are noise. The "
        f"correlation of neighbouring frames is {own:+.3f}; noise alone gives 0 ± {sigma:.3f}."
    )
    quantiles = FigureBlock("residual-quantiles", "Quantiles of the residual", caption, residual_quantiles(pictures))
    return [Section("Before and after", (maps, quantiles)), Section("Effect on strain", (_on_strain(pictures),))]


def _on_strain(pictures: DiagnosisFigureData) -> Table:
    rows = []
    for bias in pictures.on_strain:
        elastic = bias.modulus_change is not None and bias.poissons_ratio_change is not None
        changes = (f"{100 * (bias.modulus_change or 0.0):+.3g} %", f"{bias.poissons_ratio_change or 0.0:+.2g}") if elastic else ("", "")
        rows.append((bias.name, *(f"{1e6 * value:+.3g}" for value in (bias.exx, bias.eyy, bias.exy)), *changes))
    caption = "Bias of the mean strain at the highest load by each effect, and change of the elastic constants by its correction."
    return _table(caption, ("effect", "exx, 10⁻⁶", "eyy, 10⁻⁶", "exy, 10⁻⁶", "Young's modulus", "Poisson's ratio"), rows, text=False)


def _tests(diagnosis: Diagnosis) -> Section:
    rows = [(test.domain, f"{test.p_value:.3f}", f"{test.rms_px:.4f}") for test in sorted(diagnosis.where, key=lambda test: test.p_value)]
    caption = "Tests of the residual without effects by domain: p value for the family of tests, and root mean square of the residual."
    blocks: list[Block] = [_table(caption, ("domain", "p, family-wise", "rms, px"), rows, text=False)]
    largest = sorted((*diagnosis.evidence, ("nothing", 0.0)), key=lambda entry: -entry[1])[:MAX_ROWS_SHOWN]
    figure = bars([(name, max(size, 0.0), f"{size:.1f}") for name, size in largest], "ln of the Bayes factor", SIGNIFICANT)
    caption = (
        f"Logarithm of the Bayes factor of the {len(largest)} most likely effects against the model without a missing effect, "
        f"before any effect "
        f"was added. Dashed line: {SIGNIFICANT:g}, above which an effect is significant."
    )
    blocks.append(FigureBlock("evidence", "Evidence for each effect", caption, figure))
    if diagnosis.overlap:
        blocks.append(_overlap(diagnosis))
    return Section("Residual tests and evidence", tuple(blocks))


def _overlap(diagnosis: Diagnosis) -> FigureBlock:
    rows = [(name, 100 * share, f"{100 * share:.0f} %") for name, share in diagnosis.overlap[:MAX_ROWS_SHOWN]]
    group = f" Confounded group {diagnosis.group}." if diagnosis.group else ""
    caption = (
        f"Fraction of {diagnosis.effects[0].name}, after the fit of drift, distortion and motion, that each other effect with "
        f"free amplitudes "
        f"explains. Effects above the dashed line ({100 * OVERLAP_LIMIT:.0f} %) are hard to separate.{group}"
    )
    return FigureBlock("overlap", "Overlap with other effects", caption, bars(rows, "explained (%)", 100 * OVERLAP_LIMIT))


def _rows(diagnosis: Diagnosis) -> tuple[Block, ...]:
    rows = diagnosis.images.rows
    if rows is None:
        return (Paragraph(diagnosis.images.no_rows or "Rows were not analysed."),)
    caption = (
        f"Mean power of waves in the shifts of {rows.rows} rows over {rows.pairs} pairs, in units of the noise of "
        f"{rows.noise_px:.4f} px per row. "
        "Dashed line: exceeded by 1 % of the spectra of noise. Columns resolve frequencies that rows alone would alias; the disparity maps "
        "observe changes slower than a subset."
    )
    spectrum = FigureBlock("row-spectrum", "Spectrum of the row shifts", caption, row_spectrum(rows))
    return (spectrum, *(() if rows.gap is None else _gap(rows.gap, "misfit-rows")))


def _grey(diagnosis: Diagnosis) -> tuple[Block, ...]:
    grey = diagnosis.images.grey
    if grey is None:
        return (Paragraph(diagnosis.images.no_grey or "Grey levels were not analysed."),)
    text = (
        f"{grey.frames} frames in {grey.blocks} blocks fixed to the specimen, relative to the first pair: mean {grey.mean_levels:.0f}, "
        f"contrast {grey.contrast_levels:.0f} grey levels, at most {100 * grey.clipped:.2g} % black or white."
    )
    caption = (
        "Tone and sharpness of every frame against the first pair, at the same points of the specimen. Dots: frames with two standard "
        "uncertainties. Lines: fitted intensity models."
    )
    rows = [(term.name, with_sigma(term.value, term.sigma), term.unit) for term in grey.noise]
    return (
        Paragraph(text + (f" Unexplained: {grey.unexplained}." if grey.unexplained else "")),
        FigureBlock("grey-levels", "Grey levels over time", caption, intensity_history(grey)),
        _table("Noise of a pixel of grey level I: variance a + b I.", ("term", "value ± standard uncertainty", "unit"), rows),
    )


def _next(diagnosis: Diagnosis) -> list[Section]:
    proposal = choose_proposal(diagnosis)
    if proposal is None:
        return []
    between = ", ".join(proposal.candidates) or "no identified effect"
    about = f"{proposal.kind.value.replace('_', ' ')}, about {between}: {proposal.description}"
    blocks: list[Block] = [Paragraph(f"{about}. The command semlive experiment propose writes its configuration.")]
    menu = () if diagnosis.experiment is None else diagnosis.experiment.forecasts
    if menu:
        headings = ("experiment", "beam time, min", "ln odds", "ln odds per minute", "hardest pair of effects, the first assumed true")
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
        blocks.append(_table("Expected results of experiments.", headings, rows))
    return [Section("Next experiment", tuple(blocks))]


def _limits(diagnosis: Diagnosis) -> Section:
    used, total = diagnosis.run.pairs
    found = [
        "Only effects of the dictionary can be identified. An effect with the displacement field of another one is reported as ambiguous.",
        "An effect below the noise of these data is not found: an outcome of NONE is a statement about these data, not about "
        "the microscope.",
        "Strain is never corrected for an effect that is strain or has the same displacement field.",
    ]
    if used < total:
        found.append(f"{used} of {total} pairs were used, spread over the run, with a drift as much coarser.")
    if diagnosis.truncated:
        found.append("The search ended at the limit of its work: the effects are those found until then, and others may be missing.")
    found += [f"{text[0].upper()}{text[1:]}.".replace("`", "") for text in map(settling_text, SETTLING_LAWS)]
    missing = [text for text in (diagnosis.images.no_rows, diagnosis.images.no_grey) if text]
    return Section("Limits", (Bullets((*found, *missing)),))
