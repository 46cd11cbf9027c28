"""`semlive qualify`: what strain a microscope can measure, what limits it, and a protocol, without a load frame."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from semlive.cli.before_run.qualifying_run import further_log, take_pairs
from semlive.cli.shared.output_path import output_file, write_text
from semlive.cli.shared.progress_bar import multi_stage_progress
from semlive.cli.shared.report_options import pdf_option
from semlive.cli.shared.terminal import echo
from semlive.data.settings import ScanProfile
from semlive.errors import BadInput
from semlive.qualify.further import StepName, proposals
from semlive.qualify.history import all_dated, comparable, histories
from semlive.qualify.values import Figure, Qualification
from semlive.report.qualification_texts import change_text, figure_text, limiting_text, setup_text
from semlive.service.config.configuration import load_config
from semlive.service.qualification.files import read_qualification, to_json
from semlive.service.qualification.log_pairs import is_log
from semlive.service.qualification.plan import plan_of
from semlive.service.qualification.recommended import configuration_text
from semlive.service.qualification.run import Progress, QualifyRequest, qualify_source

_MICRO = 1e6
InstrumentPath = Annotated[
    Path | None,
    typer.Argument(
        help="Configuration of the instrument, or a log of it: write the run without load that qualifies it, or take it with --run."
    ),
]
Source = Annotated[
    list[Path] | None,
    typer.Option(
        "--from",
        help="Folder of exported frames, or a log of a run; frames.csv in the folder gives times and shifts. "
        "Repeat the option for the logs of further steps.",
    ),
]
InstrumentConfig = Annotated[
    Path | None,
    typer.Option(
        "--config",
        help="Configuration of the instrument: its scan profiles supply values of files, its devices take --protocol; a log has both.",
    ),
]
Run = Annotated[
    bool,
    typer.Option(
        "--run",
        help="With CONFIG, or a log: take the pairs now, end as soon as no figure needs a further pair, evaluate them, and take the "
        "further steps that are needed.",
    ),
]


def qualify(
    instrument: InstrumentPath = None,
    source: Source = None,
    history: Annotated[
        list[Path] | None,
        typer.Option("--history", help="File of an earlier qualification, or a folder of them; repeat the option for several files."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Write the result as JSON to this file, for --history.")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="Write the report as a page, REPORT.html.")] = None,
    pdf: Annotated[Path | None, typer.Option("--pdf", help="Write the report as PDF too; needs the extra pdf of semlive.")] = None,
    protocol: Annotated[
        Path | None, typer.Option("--protocol", help="Write the recommended protocol as a configuration for semlive run.")
    ] = None,
    config: InstrumentConfig = None,
    quick: Annotated[bool, typer.Option("--quick", help="Do not search the maps for effects beyond drift and distortion.")] = False,
    follow: Annotated[
        bool, typer.Option("--follow", help="With --from LOG of a run in progress: evaluate each pair, and end as soon as none is needed.")
    ] = False,
    run: Run = False,
    step: Annotated[
        StepName | None, typer.Option("--step", help="With CONFIG, or a log: write the run of a further step with another scan.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Show what strain a microscope can measure, what limits it, and the recommended protocol, from frames without load."""
    _require_one_purpose(instrument, source, history, follow=follow, step=step, run=run)
    for path, option in ((out, "--out"), (report, "--report"), (protocol, "--protocol")):
        if path is not None:
            output_file(path, option)
    pdf = pdf_option(pdf)
    if instrument is not None and not run:
        return _write_plan(instrument, protocol, step)
    if history is not None:
        return _show_history(_qualifications(history), report, pdf, as_json)
    source = list(source or ())
    if instrument is not None:
        source = [*([instrument] if step is not None and is_log(instrument) else []), take_pairs(instrument, step)]
    found, configuration = _evaluated(source, config, quick=quick, follow=follow)
    while run and (further := further_log(found, source[0])) is not None:
        source.append(further)
        found, configuration = _evaluated(source, config, quick=quick, follow=False)
    for path, text in ((out, to_json(found)), (protocol, configuration)):
        if path is not None:
            write_text(path, text)
    if report is not None or pdf is not None:
        from semlive.cli.before_run.qualification_files import write_report  # noqa: PLC0415  (Matplotlib: 0.5 s, and few ask for a report)

        write_report(found, configuration, report, pdf)
    if as_json:
        return typer.echo(to_json(found))
    _print(found)
    return _print_further(found, _instrument(source, config), source)


def _evaluated(source: list[Path], config: Path | None, *, quick: bool, follow: bool) -> tuple[Qualification, str]:
    """The qualification of folders or logs, and the recommended configuration."""
    first, *others = source
    profile = ScanProfile() if config is None else load_config(config).sem.scan_profile
    if follow and not is_log(first):
        echo(f"{first}: no log yet; it is awaited", err=True)
    with multi_stage_progress(hidden=follow) as progress:
        found = qualify_source(QualifyRequest(first, profile, not quick, follow, tuple(others)), progress, _print_progress)
    return found, configuration_text(found, first.resolve(), _instrument(source, config))


def _instrument(source: list[Path], config: Path | None) -> Path | None:
    """Configuration of the instrument, or the first log, which contains it; None if there is neither."""
    return config or (source[0] if is_log(source[0]) else None)


def _require_one_purpose(
    instrument: Path | None, source: list[Path] | None, history: list[Path] | None, *, follow: bool, step: StepName | None, run: bool
) -> None:
    """Check that the arguments request one thing.

    Raises:
        BadInput: they request none or several.
    """
    if sum(given is not None for given in (instrument, source, history)) != 1:
        raise BadInput("give CONFIG of the instrument, --from FOLDER with frames or a log, or --history with earlier qualifications")
    if follow and (source is None or len(source) > 1):
        raise BadInput("--follow needs --from LOG, the log of a run in progress, and no other")
    if instrument is None and (step is not None or run):
        option = "--run" if step is None else "--step"
        raise BadInput(f"{option} needs CONFIG, the configuration of the instrument or the log of the first run")


def _write_plan(instrument: Path, protocol: Path | None, step: StepName | None) -> None:
    """Write the qualifying run, or print it."""
    plan = plan_of(instrument, step)
    if protocol is None:
        typer.echo(plan.text, nl=False)
        return
    write_text(protocol, plan.text)
    echo(f"{protocol}: {plan.duration_text()}")
    before = f"{plan.change}, " if plan.change else ""
    log = "--from its log" if step is None else "--from the first log --from its log"
    echo(f"{before}semlive run {protocol} --until-qualified, then semlive qualify {log}")


def _print_further(found: Qualification, instrument: Path | None, source: list[Path]) -> None:
    """The further steps that are needed, with the commands to type and the time left."""
    steps = proposals(found)
    if not steps:
        echo("no further step with another scan is needed")
        return
    frame_s = found.conditions.frame_s if found.conditions.timed else 0.0
    seconds = [proposal.step.duration_s(frame_s, found.protocol.hold_s) for proposal in steps]
    left = f", about {max(sum(seconds) / 60.0, 1.0):.0f} min left" if frame_s else ""
    echo(f"further steps: {len(steps)}{left}")
    for proposal, duration_s in zip(steps, seconds, strict=True):
        step = proposal.step
        time = f", about {max(duration_s / 60.0, 1.0):.0f} min" if frame_s else ""
        echo(f"  {step.change} ({len(step.shifts)} pairs{time}): {proposal.reason}")
    name = steps[0].step.name.value
    logs = " ".join(f"--from {path}" for path in source)
    echo(f"next: semlive qualify {instrument or 'CONFIG'} --step {name} --protocol {name}.yaml")
    echo(f"      semlive run {name}.yaml --until-qualified, then semlive qualify {logs} --from its log")


def _print_progress(progress: Progress) -> None:
    """One line for each pair of a run in progress."""
    left = f"about {max(progress.left_s / 60.0, 1.0):.0f} min left" if progress.needs else "every figure is known well enough"
    reasons = "".join(f"; {need.name.replace('_', ' ')}: {need.reason}" for need in progress.needs)
    echo(f"pair {progress.pairs} of {progress.planned}: {left}{reasons}", err=True)


def _print(found: Qualification) -> None:
    console = Console()
    console.print(_figures("figures with 95 % intervals", found.figures))
    for setup in found.setups:
        console.print(_figures(setup_text(setup), setup.figures))
    strain = Table(title="strain resolution, microstrain", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
    for heading in ("gauge px", "gauge um", "noise", "95 % interval", "false strain", "corrected"):
        strain.add_column(heading, justify="right")
    for item in found.resolution:
        values = (item.noise, item.noise_low, item.noise_high, item.systematic, item.systematic_corrected)
        noise, low, high, systematic, corrected = (f"{_MICRO * value:.0f}" for value in values)
        length = f"{item.gauge_um:.4g}" if item.gauge_um else ""
        strain.add_row(str(item.gauge_px), length, noise, f"{low} to {high}", systematic, corrected)
    if found.resolution:
        console.print(strain)
    for item in found.undetermined:
        echo(f"not determined: {item.name}: {item.reason}; {item.remedy}")
    for name in found.conditions.not_paired:
        echo(f"without a pair: {name}")
    echo(limiting_text(found))


def _figures(title: str, figures: Sequence[Figure]) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1))
    for heading in ("figure", "value", "95 % interval", "unit"):
        table.add_column(heading)
    for figure in figures:
        table.add_row(figure.title, *figure_text(figure), figure.unit)
    return table


def _qualifications(paths: list[Path]) -> list[Qualification]:
    """Qualifications of files and of all JSON files of folders.

    Raises:
        BadInput: a file is no qualification, or there are fewer than two.
    """
    files = [file for path in paths for file in (sorted(path.glob("*.json")) if path.is_dir() else [path])]
    if len(files) < 2:
        raise BadInput(f"--history {paths[0]}: {len(files)} qualifications; a comparison needs at least two, from semlive qualify -o")
    return [read_qualification(file) for file in files]


def _show_history(found: list[Qualification], report: Path | None, pdf: Path | None, as_json: bool) -> None:
    series = histories(found)
    if report is not None or pdf is not None:
        from semlive.cli.before_run.qualification_files import write_history  # noqa: PLC0415  (as in `qualify`)

        write_history(found, report, pdf)
    if as_json:
        figures = [
            {"name": item.name, "time_ns": item.time_ns, "value": [figure.value for figure in item.figures], "worse": item.worse}
            for item in series
        ]
        typer.echo(json.dumps({"comparable": comparable(found), "figures": figures}))
        return
    worse = [item for item in series if item.worse]
    for item in worse:
        echo(f"worse: {change_text(item)}")
    if not worse:
        echo("no figure became worse beyond both intervals")
    if not all_dated(found):
        echo("a qualification without a date is compared in the order in which the files are given", err=True)
    if not comparable(found):
        echo("frame size, pixel size or dwell time differ between the qualifications", err=True)
