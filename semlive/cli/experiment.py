"""`semlive experiment`: what to do next, and whether a simulation bears out what was found."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from semlive.cli.track import tracked_stages
from semlive.diagnose.compare import compared
from semlive.diagnose.propose import proposed
from semlive.service.diagnosis import diagnose_log, observed
from semlive.service.model_file import fitting_model, model_of
from semlive.service.next_experiment import next_config

experiment = typer.Typer(
    help="Propose the experiment that decides between what a diagnosis leaves open; compare a run with simulations of it.",
    no_args_is_help=True,
)


@experiment.callback()
def about() -> None:
    """Propose the experiment that decides between what a diagnosis leaves open; compare a run with simulations of it."""


@experiment.command("propose")
def propose(
    log: Annotated[Path, typer.Argument(help="One MCAP file, or a run folder of segments.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Write the configuration to this file.")] = None,
    model: Annotated[Path | None, typer.Option(help="The model to begin with, as `diagnose -o` writes it.")] = None,
    seed: Annotated[int, typer.Option(help="Of the draws that the verdict is calibrated with.", min=0)] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Diagnose a run, and write the experiment that decides between what it leaves open, as a configuration for `semlive run`."""
    with tracked_stages(quiet=False) as progress:
        found = diagnose_log(log, seed, progress, (model_of(log) if model is None else fitting_model(log, model)).known.effects)
    proposal = proposed(found)
    config = None if proposal is None else next_config(log, proposal)
    if config is not None and out is not None:
        out.write_text(config, encoding="utf-8")
    if as_json:
        between = [] if proposal is None else list(proposal.between)
        told = None if proposal is None else {"kind": proposal.kind.value, "between": between, "about": proposal.about}
        typer.echo(json.dumps({"outcome": found.outcome.value, "experiment": told, "config": config}))
    elif config is None:
        typer.echo(f"{found.outcome.value}: there is nothing to decide")
    else:
        typer.echo(config if out is None else f"{found.outcome.value}: {proposal.about if proposal else ''}; written to {out}")


@experiment.command("compare")
def compare(
    log: Annotated[Path, typer.Argument(help="The measured run: one MCAP file, or a run folder of segments.")],
    without: Annotated[Path, typer.Argument(help="The same experiment on the simulator, without the effects that were found.")],
    having: Annotated[
        Path, typer.Argument(help="The same with them: the scenario that `simulate --from MODEL.json` wrote.", metavar="WITH")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Compare the maps of a run with those of two simulations of it: does the gap shrink with the effects that were found?"""
    with tracked_stages(quiet=False) as progress:
        found = compared(*(observed(one, progress) for one in (log, without, having)))
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
