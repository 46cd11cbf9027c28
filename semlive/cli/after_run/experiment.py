"""`semlive experiment`: propose the next experiment, evaluate it, and compare a run with simulations of it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from semlive.cli.after_run.confirmation import comparison_json, comparison_text
from semlive.cli.after_run.forecast_table import forecast_table
from semlive.cli.after_run.row_start import row_start
from semlive.cli.shared.output_path import output_file, write_text
from semlive.cli.shared.progress_bar import multi_stage_progress
from semlive.data.diagnosis.effects import ModelEffect, Outcome, ParameterEstimate
from semlive.data.diagnosis.verdict import ExperimentForecast
from semlive.diagnose.experiments.proposals import ExperimentKind, choose_proposal, requested_proposal
from semlive.diagnose.simulation_comparison import compare_with_simulations
from semlive.service.diagnosis.model_file import compatible_model, model_of
from semlive.service.diagnosis.next_config import next_config
from semlive.service.diagnosis.run import diagnose_log, load_observation, propose_next_experiments
from semlive.service.diagnosis.two_runs import compare_logs, decision_json
from semlive.service.diagnosis.verdict_json import forecast_json
from semlive.service.log.opened_log import OpenedLog

_DECIDED = {
    Outcome.NONE: "both scans have the same distortion; no part of it depends on the dwell time or the row time",
    Outcome.IDENTIFIED: "one effect explains both runs; it depends on the dwell time or the row time, or is present in both runs",
    Outcome.AMBIGUOUS: "several effects explain both runs equally well",
    Outcome.UNKNOWN: "the scans have different distortions, and no effect of the dictionary explains the difference",
}

_TURNED = {
    Outcome.NONE: "no effect that rotates with the scan was detected",
    Outcome.IDENTIFIED: "this effect rotates with the scan",
    Outcome.UNKNOWN: "the distortion is fixed neither to the scan nor to the column: it has parts of both kinds, or it changed",
}
_BELONGS = {
    "column": "the distortion is fixed to the column, like that of a lens",
    "scan": "the distortion rotates with the scan",
    "both": "the distortion of curved scan ramps rotates with the scan; the other part is fixed to the column",
    "neither": "the data do not determine whether the distortion is fixed to the column or to the scan",
    "": "the distortion is too small, or too symmetric, to determine whether it rotates with the scan",
}

experiment = typer.Typer(
    help="Propose an experiment that decides between possible effects, evaluate it, or compare a run with simulations of it.",
    no_args_is_help=True,
)


@experiment.callback()
def about() -> None:
    """Propose an experiment that decides between possible effects, evaluate it, or compare a run with simulations of it."""


@experiment.command("propose")
def propose(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Write the configuration to this file.")] = None,
    model: Annotated[Path | None, typer.Option(help="Model to start with, as `diagnose -o` writes it.")] = None,
    kind: Annotated[ExperimentKind | None, typer.Option(help="Propose this kind of experiment, without a diagnosis.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the random draws that calibrate the tests.", min=0)] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Diagnose a run, and write the experiment that decides between the possible effects as a configuration for `semlive run`."""
    if out is not None:
        output_file(out, "--out")
    outcome, proposal, menu = None, None, tuple[ExperimentForecast, ...]()
    opened = OpenedLog(log)
    if kind is not None:
        proposal = requested_proposal(kind)
    else:
        effects = _model_effects(opened, model)
        with multi_stage_progress() as progress:
            diagnosis, observation = diagnose_log(opened, seed, progress, effects)
            menu = propose_next_experiments(observation, diagnosis, effects)
        outcome, proposal = diagnosis.outcome.value, choose_proposal(diagnosis, menu)
    config = None if proposal is None else next_config(opened, proposal)
    if config is not None and out is not None:
        write_text(out, config)
    if as_json:
        between = [] if proposal is None else list(proposal.candidates)
        experiment_json = None if proposal is None else {"kind": proposal.kind.value, "between": between, "about": proposal.description}
        expected = [forecast_json(forecast) for forecast in menu]
        typer.echo(json.dumps({"outcome": outcome, "experiment": experiment_json, "foretold": expected, "config": config}))
    elif config is None:
        typer.echo(f"{outcome}: no experiment is needed")
    else:
        prefix = f"{outcome}: " if outcome else ""
        typer.echo(config if out is None else f"{prefix}{proposal.description if proposal else ''}; written to {out}")
        if menu:
            Console(stderr=out is None).print(forecast_table(menu))


@experiment.command("decide")
def decide(
    log: Annotated[Path, typer.Argument(help="First run: one MCAP file, or a run folder of segments.")],
    other: Annotated[
        Path,
        typer.Argument(help="Second run: the calibration again, on the same grid, with another dwell or row time or with a rotated scan."),
    ],
    model: Annotated[Path | None, typer.Option(help="Model with the effects found so far, as `diagnose -o` writes it.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compare two runs with different scans, and decide between effects of the distortion and of the scan axes."""
    first, second = OpenedLog(log), OpenedLog(other)
    with multi_stage_progress() as progress:
        decision = compare_logs((first, second), progress, _model_effects(first, model))
    if as_json:
        typer.echo(json.dumps(decision_json(decision)))
        return
    typer.echo(f"{decision.outcome.value}: {(_TURNED if decision.turned else _DECIDED)[decision.outcome]}")
    for effect in decision.effects or ([decision.effect] if decision.effect else []):
        typer.echo(f"{effect.name}, at most {effect.peak_px:.3f} px")
        _print_parameters(effect.parameters)
    if decision.turned is not None:
        typer.echo(_BELONGS[decision.turned.follows])
        _print_parameters((decision.turned.angle_rad, decision.turned.x_excess, decision.turned.skew))
    if decision.ambiguous:
        typer.echo(f"possible effects: {', '.join(decision.ambiguous)}")
    typer.echo(f"most likely: {', '.join(f'{name} {factor:.1f}' for name, factor in decision.evidence[:4])} (logarithms of Bayes factors)")


def _model_effects(log: OpenedLog, model: Path | None) -> tuple[ModelEffect, ...]:
    return (model_of(log) if model is None else compatible_model(log, model)).effect_model.effects


def _print_parameters(parameters: Sequence[ParameterEstimate]) -> None:
    for parameter in parameters:
        typer.echo(f"  {parameter.name} {parameter.value:.4g} +- {parameter.sigma:.2g} {parameter.unit}")


@experiment.command("compare")
def compare(
    log: Annotated[Path, typer.Argument(help="The measured run: one MCAP file, or a run folder of segments.")],
    without: Annotated[Path, typer.Argument(help="The same experiment on the simulator, without the identified effects.")],
    with_effects: Annotated[
        Path, typer.Argument(help="The same experiment with them: the scenario that `simulate --from MODEL.json` wrote.", metavar="WITH")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compare the maps of a run with two simulations of it, without and with the identified effects: do the effects close the gap?"""
    with multi_stage_progress() as progress:
        comparison = compare_with_simulations(*(load_observation(OpenedLog(path), progress) for path in (log, without, with_effects)))
    if as_json:
        typer.echo(json.dumps(comparison_json(comparison)))
        return
    typer.echo(comparison_text(comparison))


experiment.command("row-start")(row_start)
