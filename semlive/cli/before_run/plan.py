"""`semlive plan`: show an experiment before it is run."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from semlive.cli.before_run.recommendation_text import recommendation_json, recommendation_rows
from semlive.cli.before_run.stop_table import stop_json, stop_table
from semlive.cli.shared.progress_bar import multi_stage_progress
from semlive.data.checks import Finding
from semlive.engine.schedule import dose_c_m2
from semlive.service.checks.instrument import check_trigger
from semlive.service.config.configuration import Config, load_config
from semlive.service.config.plausibility import questions
from semlive.service.diagnosis.model_file import config_with_model
from semlive.service.planning.planning import ExperimentPlan, plan_experiment
from semlive.service.replay.replay import ReplayCallbacks

_ELECTRONS_PER_C = 1.0 / 1.602176634e-19


def plan(
    config: Annotated[Path, typer.Argument(help="YAML configuration of the run.")],
    test_frame: Annotated[Path | None, typer.Option("--test-frame", help="One frame of the specimen as the SEM exports it.")] = None,
    log: Annotated[Path | None, typer.Option("--log", help="Log of an earlier run at this microscope; its distortion is used.")] = None,
    model: Annotated[Path | None, typer.Option(help="Model of effects that are corrected in the maps, as `diagnose -o` writes it.")] = None,
    current_na: Annotated[float, typer.Option("--current-na", help="Beam current in nA, for the dose.", min=0.0)] = 1.0,
    force_noise_n: Annotated[
        float,
        typer.Option(
            "--force-noise-n", help="Standard deviation of the force reading under constant load in N, for the stop distances.", min=0.0
        ),
    ] = 0.0,
    force_resolution_n: Annotated[
        float, typer.Option("--force-resolution-n", help="Resolution of the force reading in N, for the stop distances.", min=0.0)
    ] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Show an experiment before it is run: time, frames, dose, noise, false strain, largest load after each fault, and advice."""
    checked = config_with_model(load_config(config), model, resume=False)
    with multi_stage_progress() as progress:
        planned = plan_experiment(
            checked, test_frame, log, ReplayCallbacks(progress), force_noise_n=force_noise_n, force_resolution_n=force_resolution_n
        )
    dose, unusual, microscope = _dose(planned, current_na), questions(checked), tuple(check_trigger(checked))
    if as_json:
        reported = {"trigger": [finding.to_json() for finding in microscope]} if microscope else {}
        typer.echo(json.dumps({**_json(planned, dose), "unusual": [asdict(value) for value in unusual], **reported}))
        return
    console = Console()
    console.print(_facts(planned, dose, current_na, microscope))
    console.print(_configuration_table(checked))
    console.print(_steps(planned))
    if planned.gauges:
        console.print(_noise(planned, checked.estimate.window_points))
    if planned.false_strain:
        console.print(_false_strain(planned))
    if planned.stops is not None:
        console.print(stop_table(planned.stops))
    for value in unusual:
        refused = "" if value.confirmed else "; semlive run refuses it until it is confirmed"
        console.print(f"? {value.key}: {value.what}; {value.advice}{refused}", style="yellow", highlight=False, markup=False)
    for number, advice in enumerate(planned.advice, start=1):
        console.print(f"{number}. {advice}", highlight=False)
    if not planned.advice:
        console.print("no advice")


def _dose(planned: ExperimentPlan, current_na: float) -> float | None:
    scan = planned.scan
    return None if scan.dwell_s is None else dose_c_m2(planned.schedule.scans, scan.dwell_s, current_na * 1e-9, scan.pixel_size_m)


def _json(planned: ExperimentPlan, dose: float | None) -> dict[str, object]:
    times, quality = planned.schedule, planned.quality
    return {
        "model": list(planned.effects),
        "duration_s": times.duration_s,
        "waiting_at_most_s": times.max_waiting_s,
        "pairs": len(times.steps),
        "frames": times.pair_frames,
        "scans": times.scans,
        "dose_c_m2": dose,
        "scan": asdict(planned.scan),
        "steps": [asdict(item) for item in times.steps],
        "displacement_sigma_px": None if quality is None or not quality.usable.any() else list(quality.median_sigma_px),
        "strain_sigma": [asdict(item) for item in planned.gauges],
        "mean_strain_sigma": None if planned.mean_sigma is None else asdict(planned.mean_sigma),
        "false_strain": {"distortion": planned.distortion, "shifts": [asdict(item) for item in planned.false_strain]},
        "stop_distances": None if planned.stops is None else stop_json(planned.stops),
        "recommended": recommendation_json(planned.recommended),
        "advice": list(planned.advice),
    }


def _facts(planned: ExperimentPlan, dose: float | None, current_na: float, microscope: tuple[Finding, ...]) -> Table:
    times, scan, grid = planned.schedule, planned.scan, planned.grid
    table = Table(box=SIMPLE_HEAD, show_header=False, padding=(0, 1))
    more = f", and up to {_clock(times.max_waiting_s)} of waiting" if times.max_waiting_s else ""
    rows = [
        ("duration", _clock(times.duration_s) + more),
        ("frames", f"{times.pair_frames} in {len(times.steps)} pairs; the field is scanned {times.scans} times"),
        ("a scan", f"{scan.frame_s:.2f} s, {scan.width_px} x {scan.height_px} px of {1e9 * scan.pixel_size_m:.4g} nm (from {scan.source})"),
        ("points", f"{grid.nx} x {grid.ny} = {grid.nx * grid.ny}, subset {grid.subset_px} px, step {grid.step_px} px"),
    ]
    if planned.effects:
        rows.append(("model", f"{', '.join(planned.effects)}, fitted again after each pair from the fifth pair on"))
    if dose is not None:
        electrons = dose * _ELECTRONS_PER_C * 1e-18
        rows.append(("dose", f"{dose:.3g} C/m² = {electrons:.3g} electrons per nm², at {current_na:g} nA (--current-na)"))
    if planned.quality is not None and planned.quality.usable.any():
        u, v = planned.quality.median_sigma_px
        rows.append(("displacement noise", f"{u:.4f} px along x, {v:.4f} px along y, of one point in one pair"))
    if planned.recommended is not None:
        rows += recommendation_rows(planned.recommended)
    if planned.mean_sigma is not None:
        mean = planned.mean_sigma
        rows.append(("mean strain noise", f"exx {mean.exx:.1e}, eyy {mean.eyy:.1e}, exy {mean.exy:.1e}; drift and distortion add to it"))
    rows += [("trigger", f"{finding.observation}; {finding.advice}") for finding in microscope]
    for row in rows:
        table.add_row(*row)
    return table


def _configuration_table(config: Config) -> Table:
    """Values of the configuration in which a typing error has large effects, as semlive reads them."""
    table = Table(title="configuration as read", title_justify="left", box=SIMPLE_HEAD, show_header=False, padding=(0, 1))
    protocol, limits, area = config.protocol, config.limits, config.specimen.area_mm2
    if protocol.loads_n:
        tolerance = f"± {protocol.load_tolerance_n:g} N or {100 * protocol.load_tolerance_fraction:g} %"
        table.add_row(
            "loads", f"{', '.join(f'{load_n:g}' for load_n in protocol.loads_n)} N {tolerance}, at {protocol.ramp_rate_n_s:g} N/s"
        )
    if limits is not None and config.load_frame is not None:
        table.add_row("force", f"{limits.force_min_n:g} to {limits.force_max_n:g} N, in steps of at most {limits.force_step_max_n:g} N")
        table.add_row("extension", f"{limits.extension_min_mm:g} to {limits.extension_max_mm:g} mm")
    table.add_row("cross-section", "not given" if area is None else f"{area:g} mm²")
    table.add_row("holds", f"{protocol.hold_s:g} s, after {protocol.settle_s:g} s within tolerance")
    return table


def _steps(planned: ExperimentPlan) -> Table:
    table = Table(title="steps", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
    for heading in ("phase", "pairs", "begins", "ends"):
        table.add_column(heading, justify="left" if heading == "phase" else "right")
    for phase in dict.fromkeys(step.phase for step in planned.schedule.steps):
        steps = [step for step in planned.schedule.steps if step.phase is phase]
        table.add_row(phase.value, str(len(steps)), _clock(steps[0].begins_s), _clock(steps[-1].ends_s))
    return table


def _noise(planned: ExperimentPlan, window_points: int) -> Table:
    table = Table(title="expected noise of strain, one gauge", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
    for heading in ("points", "gage px", "exx", "eyy", "exy"):
        table.add_column(heading, justify="right")
    for gauge in planned.gauges:
        values = (f"{getattr(gauge.sigma, name):.1e}" for name in ("exx", "eyy", "exy"))
        configured = gauge.window_points == window_points
        table.add_row(
            f"{gauge.window_points}{' *' if configured else ''}", str(gauge.vsg_px), *values, style="bold" if configured else None
        )
    table.caption = "* as configured"
    return table


def _false_strain(planned: ExperimentPlan) -> Table:
    table = Table(title="false strain if distortion were not corrected, 1e-6", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
    table.add_column("shift px")
    for name in ("exx", "eyy", "exy"):
        table.add_column(name, justify="right")
    for shift in planned.false_strain:
        ranges = (f"{1e6 * getattr(shift.low, name):+.0f} ... {1e6 * getattr(shift.high, name):+.0f}" for name in ("exx", "eyy", "exy"))
        table.add_row(f"{shift.shift_px[0]:g}, {shift.shift_px[1]:g}", *ranges)
    table.caption = f"distortion: {planned.distortion}"
    return table


def _clock(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min"
