"""`semlive experiment`: what to do next, what it decides, and whether a simulation bears out what was found."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from semlive.cli.forecast_table import forecast_table
from semlive.cli.progress_bar import multi_stage_progress
from semlive.data.diagnosis.effects import Outcome, ParameterEstimate
from semlive.data.diagnosis.verdict import ExperimentForecast
from semlive.diagnose.experiments.proposals import ExperimentKind, choose_proposal, requested_proposal
from semlive.diagnose.simulation_comparison import compare_with_simulations
from semlive.service.diagnosis.model_file import compatible_model, model_of
from semlive.service.diagnosis.next_config import next_config
from semlive.service.diagnosis.run import diagnose_log, forecast_json, load_observation, propose_next_experiments
from semlive.service.diagnosis.two_runs import compare_logs, decision_json

_DECIDED = {
    Outcome.NONE: "both scans have the same distortion; nothing in them goes with the dwell or the row time",
    Outcome.IDENTIFIED: "this goes with the dwell or the row time, or is in both runs, and nothing else would do",
    Outcome.AMBIGUOUS: "several effects would do",
    Outcome.UNKNOWN: "the scans have different distortions, and no known effect says why",
}

_TURNED = {
    Outcome.NONE: "nothing is known to turn with the scan",
    Outcome.IDENTIFIED: "this turns with the scan",
    Outcome.UNKNOWN: "the distortion neither turned with the scan nor stayed with the column: there is some of both kinds, or it changed",
}
_BELONGS = {
    "column": "the distortion stays with the column, as a lens's does",
    "scan": "the distortion turns with the scan",
    "both": "of the distortion, curved ramps turn with the scan; the rest stays with the column",
    "neither": "where the distortion belongs cannot be told",
    "": "the distortion is too small, or too alike from all sides, to tell whether it turns with the scan",
}

experiment = typer.Typer(
    help="Propose the experiment that decides what a diagnosis leaves open; decide by it; compare a run with simulations of it.",
    no_args_is_help=True,
)


@experiment.callback()
def about() -> None:
    """Propose the experiment that decides what a diagnosis leaves open; decide by it; compare a run with simulations of it."""


@experiment.command("propose")
def propose(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Write the configuration to this file.")] = None,
    model: Annotated[Path | None, typer.Option(help="The model to begin with, as `diagnose -o` writes it.")] = None,
    kind: Annotated[ExperimentKind | None, typer.Option(help="This experiment, whatever a diagnosis leaves open.")] = None,
    seed: Annotated[int, typer.Option(help="Of the draws that the verdict is calibrated with.", min=0)] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Diagnose a run, and write the experiment that decides between what it leaves open, as a configuration for `semlive run`."""
    outcome, proposal, menu = None, None, tuple[ExperimentForecast, ...]()
    if kind is not None:
        proposal = requested_proposal(kind)
    else:
        known = (model_of(log) if model is None else compatible_model(log, model)).effect_model.effects
        with multi_stage_progress(quiet=False) as progress:
            found = diagnose_log(log, seed, progress, known)
            menu = propose_next_experiments(log, found, progress, known)
        outcome, proposal = found.outcome.value, choose_proposal(found, menu)
    config = None if proposal is None else next_config(log, proposal)
    if config is not None and out is not None:
        out.write_text(config, encoding="utf-8")
    if as_json:
        between = [] if proposal is None else list(proposal.candidates)
        told = None if proposal is None else {"kind": proposal.kind.value, "between": between, "about": proposal.description}
        expected = [forecast_json(one) for one in menu]
        typer.echo(json.dumps({"outcome": outcome, "experiment": told, "foretold": expected, "config": config}))
    elif config is None:
        typer.echo(f"{outcome}: there is nothing to decide")
    else:
        said = f"{outcome}: " if outcome else ""
        typer.echo(config if out is None else f"{said}{proposal.description if proposal else ''}; written to {out}")
        if menu:
            Console(stderr=out is None).print(forecast_table(menu))


@experiment.command("decide")
def decide(
    log: Annotated[Path, typer.Argument(help="The run: one MCAP file, or a run folder of segments.")],
    other: Annotated[
        Path, typer.Argument(help="The calibration again: with another dwell or row time, on the same grid, or with the scan turned.")
    ],
    model: Annotated[Path | None, typer.Option(help="Effects that are known already, as `diagnose -o` writes them.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Decide by two runs with different scans what one cannot tell: of the distortion, and of the scan's axes."""
    with multi_stage_progress(quiet=False) as progress:
        found = compare_logs(
            (log, other), progress, (model_of(log) if model is None else compatible_model(log, model)).effect_model.effects
        )
    if as_json:
        typer.echo(json.dumps(decision_json(found)))
        return
    typer.echo(f"{found.outcome.value}: {(_TURNED if found.turned else _DECIDED)[found.outcome]}")
    for effect in found.effects or ([found.effect] if found.effect else []):
        typer.echo(f"{effect.name}, at most {effect.peak_px:.3f} px" if effect.peak_px else effect.name)
        _tell(effect.parameters)
    if found.turned is not None:
        typer.echo(_BELONGS[found.turned.follows])
        _tell((found.turned.angle_rad, found.turned.x_excess, found.turned.skew))
    if found.ambiguous:
        typer.echo(f"between {', '.join(found.ambiguous)}")
    typer.echo(f"loudest: {', '.join(f'{name} {factor:.1f}' for name, factor in found.evidence[:4])} (logarithms of Bayes factors)")


def _tell(parameters: Sequence[ParameterEstimate]) -> None:
    for one in parameters:
        typer.echo(f"  {one.name} {one.value:.4g} +- {one.sigma:.2g} {one.unit}")


@experiment.command("compare")
def compare(
    log: Annotated[Path, typer.Argument(help="The measured run: one MCAP file, or a run folder of segments.")],
    without: Annotated[Path, typer.Argument(help="The same experiment on the simulator, without the effects that were found.")],
    with_effects: Annotated[
        Path, typer.Argument(help="The same with them: the scenario that `simulate --from MODEL.json` wrote.", metavar="WITH")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compare the maps of a run with those of two simulations of it: does the gap shrink with the effects that were found?"""
    with multi_stage_progress(quiet=False) as progress:
        found = compare_with_simulations(*(load_observation(one, progress) for one in (log, without, with_effects)))
    if as_json:
        typer.echo(json.dumps({**asdict(found), "confirmed": found.confirmed}))
        return
    maps, sizes = found.maps, found.sizes
    typer.echo(
        f"{'confirmed' if found.confirmed else 'not confirmed'}, by {found.frames} maps of {found.blocks} blocks\n"
        f"measured less simulated maps: {maps.before_px:.4f} px without the effects, {maps.after_px:.4f} px with them, "
        f"{maps.floor_px:.4f} px is noise; {_share(maps.closure, maps.interval)} closed\n"
        f"smooth and more than noise: {sizes.measured_px:.4f} px measured, {sizes.simulated_px:.4f} px simulated with them"
        + (f", {_share(sizes.ratio, sizes.interval)} of it" if sizes.measured_px > 0.0 else "")
    )


def _share(share: float, interval: tuple[float, float]) -> str:
    return f"{100 * share:.0f} % ({100 * interval[0]:.0f} to {100 * interval[1]:.0f} %)"
