"""`semlive run`: run the daemon in the foreground of a terminal."""

from __future__ import annotations

import contextlib
import json
import queue
import sys
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from semlive.cli.during_run.qualification_process import QualificationProcess
from semlive.cli.during_run.run_status import ProgressView
from semlive.cli.shared.live_page import PORT, Host, Name, PageAddress, PageProcess, Port
from semlive.engine import OperatorCommand
from semlive.errors import BadConfig, SemliveError
from semlive.inputs.printable import printable
from semlive.service.config.configuration import Config, load_config
from semlive.service.config.plausibility import refuse_unusual
from semlive.service.control.socket import SocketAddress
from semlive.service.daemon import RunInterface, run_experiment
from semlive.service.log.alarms import ACKNOWLEDGE, AcknowledgeAll
from semlive.service.log.files import segments
from semlive.service.log.opened_log import OpenedLog
from semlive.service.runtime.drivers import operator_interfaces
from semlive.service.runtime.memory import single_arena_small_blocks


def run(
    config: Annotated[Path, typer.Argument(help="YAML configuration of the run.")],
    attended: Annotated[
        bool, typer.Option("--attended", help="The operator stays at the instrument; real load frames require it.")
    ] = False,
    stop_on_fault: Annotated[
        bool, typer.Option("--stop-on-fault", help="End the run at a fault instead of waiting for the operator.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue an interrupted run; the operator confirms before anything moves.")
    ] = False,
    model: Annotated[
        Path | None,
        typer.Option(
            help="Model of effects that are corrected in the maps, as `diagnose -o` writes it; with --resume that of the log is used."
        ),
    ] = None,
    until_qualified: Annotated[
        bool, typer.Option("--until-qualified", help="With a run that `qualify` wrote: end it as soon as no figure needs a further pair.")
    ] = False,
    yes: Annotated[
        bool,
        typer.Option("--yes", help="With --resume: continue without confirmation if the devices are in the state that the log recorded."),
    ] = False,
    no_page: Annotated[bool, typer.Option("--no-page", help="Do not start the live page.")] = False,
    stay: Annotated[bool, typer.Option("--stay", help="Keep the live page open after the run, until Ctrl-C.")] = False,
    page_host: Host = "127.0.0.1",
    page_port: Port = PORT,
    page_name: Name = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object after the run.")] = False,
) -> None:
    """Run an experiment; type pause, resume, stop, abort or acknowledge and press Enter, or Ctrl-C to stop."""
    single_arena_small_blocks()
    checked = _with_model(load_config(config), model, resume)
    refuse_unusual(checked, str(config))
    if until_qualified and checked.protocol.loads_n:
        raise BadConfig(f"{config}: --until-qualified is for a run without load, as `semlive qualify` writes it; leave it out, or loads_n")
    if yes and not resume:
        raise BadConfig("--yes confirms --resume; give both options, or leave --yes out")
    commands = _typed_commands(checked) if sys.stdin.isatty() else queue.SimpleQueue()
    console = Console(stderr=True)
    place = PageAddress(page_host, page_port, tuple(page_name or ()))
    with contextlib.ExitStack() as stack:
        with ProgressView(console) as view:
            log = checked.run.folder / checked.run.name
            qualification = QualificationProcess(log, view.show_line)
            stack.callback(qualification.close)
            open_page = None if no_page else partial(_open_page, stack, view, log, place)
            on_open = _each_of(open_page, qualification.start if until_qualified else None)
            outcome = run_experiment(checked, RunInterface(view.show, commands, attended, stop_on_fault, resume, yes, on_open))
        for line in (outcome.text, f"log: {outcome.log}"):
            console.print(printable(line), markup=False)
        if stay and not no_page:
            console.print("the live page stays open until Ctrl-C")
            with contextlib.suppress(KeyboardInterrupt):
                threading.Event().wait()
    if as_json:
        typer.echo(json.dumps({"complete": outcome.complete, "text": outcome.text, "log": str(outcome.log)}))
    if not outcome.complete and not qualification.has_stopped_run:
        raise SemliveError(f"the run did not complete: {outcome.text}")


def _with_model(config: Config, model: Path | None, resume: bool) -> Config:
    """Configuration with the model of effects that the run corrects; a run without a model needs no numerical packages."""
    folder = config.run.folder / config.run.name
    if model is None and config.model is None:
        logged = OpenedLog(folder).run.config if resume and segments(folder) else {}
        if logged.get("model") is None:
            return config
    from semlive.service.diagnosis.model_file import config_with_model  # noqa: PLC0415  (1.5 s of processor time)

    return config_with_model(config, model, resume)


def _each_of(*starts: Callable[[SocketAddress], object] | None) -> Callable[[SocketAddress], object] | None:
    """A function that calls those that are given; None if none is."""
    given = [start for start in starts if start is not None]
    return (lambda address: [start(address) for start in given]) if given else None


def _open_page(stack: contextlib.ExitStack, view: ProgressView, log: Path, place: PageAddress, address: SocketAddress) -> None:
    """Start the page and show its address, which contains the token; if the page cannot start, the run continues without it."""

    def ready(page: str | None, reason: str) -> None:
        view.show_line(
            f"the live page cannot start ({reason}); check whether its address is one of this computer"
            if page is None
            else f"live page: {page}#token={address.token}"
        )

    stack.callback(PageProcess(log, place, ready, address).close)


def _typed_commands(config: Config) -> queue.SimpleQueue[OperatorCommand | AcknowledgeAll]:
    """Queue of the commands that the operator types from now on."""
    commands: queue.SimpleQueue[OperatorCommand | AcknowledgeAll] = queue.SimpleQueue()
    if any(section is not None and section.driver == "operator" for section in (config.load_frame, config.stage, config.sem.trigger)):
        for interface in operator_interfaces().values():  # the drivers read the other lines as answers to their prompts
            interface.add_answer_source(partial(_queue_command, commands))
    else:
        threading.Thread(target=_listen, args=(commands,), daemon=True).start()
    return commands


def _listen(commands: queue.SimpleQueue[OperatorCommand | AcknowledgeAll]) -> None:
    """Read the commands that the operator types; runs in a thread."""
    for line in sys.stdin:
        if not _queue_command(commands, line) and line.strip():
            sys.stderr.write(f"{printable(line.strip())}: type one of {', '.join((*OperatorCommand, ACKNOWLEDGE))}\n")


def _queue_command(commands: queue.SimpleQueue[OperatorCommand | AcknowledgeAll], line: str) -> bool:
    """Whether a line is a command, which is then queued.

    Commands are recognised first, because a stage driver of the operator would read "stop" as the end of a move.
    """
    command = line.strip().lower()
    if command == ACKNOWLEDGE:
        commands.put(AcknowledgeAll("terminal"))
        return True
    if command not in list(OperatorCommand):
        return False
    commands.put(OperatorCommand(command))
    return True
