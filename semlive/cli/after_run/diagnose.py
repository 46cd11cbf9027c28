"""`semlive diagnose`: where model and data disagree, and which effect is missing."""

from __future__ import annotations

import json
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from semlive.cli.after_run.confirmation import SimulationRequest, new_folder, proof_json, proof_text
from semlive.cli.after_run.confirmation import prove as prove_diagnosis
from semlive.cli.after_run.forecast_table import forecast_table
from semlive.cli.shared.output_path import emptied_if_refused, output_file, regular_output_file, write_text
from semlive.cli.shared.progress_bar import multi_stage_progress
from semlive.cli.shared.report_files import write_report_files
from semlive.cli.shared.report_options import figures_option, pdf_option
from semlive.data.diagnosis.effects import IdentifiedEffect, Outcome
from semlive.data.diagnosis.verdict import SETTLING_LAWS, UNDERRESOLVED, Diagnosis, settling_text
from semlive.report.diagnosis_report import diagnosis_report
from semlive.report.document.html_writer import html_page
from semlive.service.diagnosis.model_file import compatible_model, model_of, write_model
from semlive.service.diagnosis.run import diagnose_log
from semlive.service.diagnosis.verdict_json import diagnosis_json
from semlive.service.log.opened_log import OpenedLog
from semlive.service.log.pairs import first_frame
from semlive.service.runtime.memory import single_arena_for_matrices

_OUTCOME_TEXTS = {
    Outcome.NONE: "no effect is missing that these data could show",
    Outcome.IDENTIFIED: "the effects below are missing, and no other explanation is comparable",
    Outcome.AMBIGUOUS: "an effect is missing; several effects explain the data equally well",
    Outcome.UNKNOWN: "an effect is missing that is not in the dictionary",
    Outcome.REJECTED: "the best effect does not explain the held-out pairs",
}


def diagnose(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    model: Annotated[Path | None, typer.Option(help="Model to start with, as `-o` writes it.")] = None,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Write the model with the identified effects to this file.")] = None,
    page: Annotated[Path | None, typer.Option("--html", help="Write the diagnosis as one HTML page to this file.")] = None,
    pdf: Annotated[
        Path | None, typer.Option("--pdf", help="Write the diagnosis as PDF to this file; needs the extra pdf of semlive.")
    ] = None,
    pictures: Annotated[
        Path | None, typer.Option("--figures", help="Folder for every figure as PNG, SVG and PDF, and for the captions.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the random draws that calibrate the tests.", min=0)] = 0,
    prove: Annotated[
        str | None,
        typer.Option(
            metavar="SCENARIO",
            help="Simulate the run without and with the identified effects, compare, and write one page. A scenario with the protocol of "
            "the run: two simulated runs of as many pairs as the log, no longer ones; none without an identified effect.",
        ),
    ] = None,
    prove_out: Annotated[Path, typer.Option(help="Folder for model, page and simulated runs of --prove; new or empty.")] = Path("prove"),
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Find where model and data disagree, identify the missing effect, and show how much of the gap it closes."""
    single_arena_for_matrices()
    if out is not None:
        regular_output_file(out, "--out")
    if page is not None:
        output_file(page, "--html")
    simulation = None if prove is None else SimulationRequest(prove, new_folder(prove_out, "--prove-out"))
    pdf, pictures = pdf_option(pdf), figures_option(pictures)
    opened = OpenedLog(log)
    parent = model_of(opened) if model is None else compatible_model(opened, model)
    with multi_stage_progress() as progress:
        diagnosis, observation = diagnose_log(opened, seed, progress, parent.effect_model.effects)
    if out is not None:
        write_model(out, diagnosis, opened, parent)
    proof = None
    if simulation is not None:
        page = page or simulation.folder / "diagnosis.html"
        with emptied_if_refused(simulation.folder), multi_stage_progress() as progress:
            write = partial(write_model, verdict=diagnosis, log=opened, parent=parent)
            proof = prove_diagnosis(diagnosis, observation, log, write, simulation, progress)
    if page is not None or pdf is not None or pictures is not None:
        made_from = [("log", log.name), ("model", parent.name), ("seed", str(seed)), ("semlive", version("semlive"))]
        document = diagnosis_report(log.name, diagnosis, made_from, first_frame(log), proof)
        if page is not None:
            write_text(page, html_page(document))
        write_report_files(document, pdf, pictures)
    if as_json:
        more = {} if proof is None or page is None else proof_json(proof, page)
        typer.echo(json.dumps({**diagnosis_json(diagnosis), **more}))
        return
    console = Console()
    _print_diagnosis(console, diagnosis)
    if proof is not None:
        console.print(f"{proof_text(proof)}\npage: {page}")


def _print_diagnosis(console: Console, diagnosis: Diagnosis) -> None:
    console.print(f"{diagnosis.outcome.value}: {_OUTCOME_TEXTS[diagnosis.outcome]}")
    found = diagnosis.outcome is not Outcome.UNKNOWN
    for effect in diagnosis.effects:
        console.print(_effect_table(effect, found))
    for reason in diagnosis.further_misfit:
        console.print(f"not explained: {reason.text}")
    if diagnosis.closest:
        shares = ", ".join(f"{name} ({100 * share:.0f} %)" for name, share in diagnosis.closest)
        console.print(f"closest effects, none of them found, with the share of the gap that each closes alone: {shares}")
    test = diagnosis.adequacy
    if test is not None and not test.passed:
        console.print(
            f"with all effects the residual of the maps is still not noise: test over {test.domain}, p = {test.p_value:.1g}, "
            f"{test.rms_px:.4f} px rms"
        )
    outside = diagnosis.outside
    if outside is not None and outside.p_value < 1.0:
        console.print(
            f"anything outside the catalogue: p = {outside.p_value:.2g}, conformal, from the outcomes of {outside.experiments} simulated "
            "experiments with at most listed effects; exact for experiments like those"
        )
    for name in diagnosis.coarse:
        console.print(f"{name}: {UNDERRESOLVED[name]}")
    if diagnosis.truncated:
        console.print("the search ended at the limit of its work: the effects above are those found so far, and others may be missing")
    used, total = diagnosis.run.pairs
    if used < total:
        console.print(f"{used} of {total} pairs were used, spread over the run, with a drift as much coarser")
    _print_gap(console, diagnosis)
    console.print(_where_table(diagnosis))
    rows = diagnosis.images.rows
    if rows is None:
        console.print(diagnosis.images.no_rows)
    else:
        console.print(f"rows: {rows.pairs} pairs of {rows.rows}, {rows.outcome.value}; noise of a pair {rows.noise_px:.4f} px")
    console.print(_grey_line(diagnosis))
    for start in SETTLING_LAWS:
        console.print(settling_text(start))
    if diagnosis.experiment is not None:
        console.print(f"to decide between {', '.join(diagnosis.experiment.between)}: {diagnosis.experiment.about}")
        if diagnosis.experiment.forecasts:
            console.print(forecast_table(diagnosis.experiment.forecasts))


def _grey_line(diagnosis: Diagnosis) -> str:
    grey = diagnosis.images.grey
    if grey is None:
        return diagnosis.images.no_grey
    dark, slope = grey.noise
    residual = f"; {grey.unexplained}" if grey.unexplained else ""
    return (
        f"grey levels: {grey.frames} frames in {grey.blocks} blocks, {grey.outcome.value}{residual}; variance of a pixel "
        f"({dark.value:.3g} +- {dark.sigma:.2g}) + ({slope.value:.3g} +- {slope.sigma:.2g}) I"
    )


def _effect_table(effect: IdentifiedEffect, found: bool) -> Table:
    evidence = f"p = {effect.p_value:.3f}, logarithm of the Bayes factor {effect.log_bayes_factor:.1f}"
    state = "" if found else "closest, not found: "
    table = Table(title=f"{state}{effect.name}: at most {effect.peak_px:.3f} px, {evidence}")
    for heading in ("parameter", "value", "sigma", "unit"):
        table.add_column(heading)
    for parameter in effect.parameters:
        estimates = [(parameter.name, parameter.value, parameter.sigma), *(("or", *other) for other in parameter.alternatives)]
        for name, value, sigma in estimates:
            table.add_row(name, f"{value:.4g}", f"{sigma:.2g}", parameter.unit)
    if effect.strain:
        modulus = effect.modulus_bias
        bias = "" if modulus is None else f"; it would change Young's modulus by {100 * modulus.value:+.2g} +- {100 * modulus.sigma:.2g} %"
        table.caption = f"this effect is strain or has the same displacement field as strain: strain is not corrected for it{bias}"
    return table


def _print_gap(console: Console, diagnosis: Diagnosis) -> None:
    gap = diagnosis.gap
    if gap is not None:
        low, high = gap.closure_interval
        console.print(
            f"gap (rms residual of held-out pairs): {gap.before_px:.4f} px before, {gap.after_px:.4f} px after, "
            f"{gap.floor_px:.4f} px is noise; "
            f"{100 * gap.closure:.0f} % closed ({100 * low:.0f} to {100 * high:.0f} %)"
        )


def _where_table(diagnosis: Diagnosis) -> Table:
    table = Table(title="where model and data disagree, before")
    for heading in ("domain", "p", "rms px"):
        table.add_column(heading)
    for test in sorted(diagnosis.where, key=lambda item: item.p_value):
        table.add_row(test.domain, f"{test.p_value:.3f}", f"{test.rms_px:.4f}")
    return table
