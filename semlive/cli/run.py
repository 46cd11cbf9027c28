"""`semlive run`: the daemon in the foreground of a terminal."""

from __future__ import annotations

import contextlib
import queue
import sys
import threading
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from semlive.cli.live_page import PORT, Host, Name, PageAddress, PageProcess, Port
from semlive.cli.run_status import ProgressView
from semlive.data.text import printable
from semlive.engine import OperatorCommand
from semlive.errors import BadConfig, SemliveError
from semlive.service.config.configuration import load_config
from semlive.service.config.plausibility import refuse_unusual
from semlive.service.control.socket import SocketAddress
from semlive.service.daemon import RunInterface, run_experiment
from semlive.service.diagnosis.model_file import config_with_model
from semlive.service.log.alarms import ACKNOWLEDGE, AcknowledgeAll
from semlive.service.runtime.drivers import operator_interfaces
from semlive.service.runtime.memory import single_arena_small_blocks


def run(
    config: Annotated[Path, typer.Argument(help="YAML configuration of the run.")],
    attended: Annotated[bool, typer.Option("--attended", help="You stay at the instrument; real load frames ask for it.")] = False,
    stop_on_fault: Annotated[bool, typer.Option("--stop-on-fault", help="End the run at a fault instead of waiting for you.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Take up a run that was interrupted, and ask before anything moves.")] = False,
    model: Annotated[
        Path | None, typer.Option(help="Effects to take out of the maps, as `diagnose -o` writes them; with --resume the log's own stay.")
    ] = None,
    yes: Annotated[
        bool, typer.Option("--yes", help="With --resume: go on without being asked, if the devices are as the log left them.")
    ] = False,
    no_page: Annotated[bool, typer.Option("--no-page", help="Without the live page.")] = False,
    stay: Annotated[bool, typer.Option("--stay", help="Keep the live page after the run, until Ctrl-C.")] = False,
    page_host: Host = "127.0.0.1",
    page_port: Port = PORT,
    page_name: Name = None,
) -> None:
    """Run an experiment; type pause, resume, stop, abort or acknowledge and press Enter, or Ctrl-C to stop."""
    single_arena_small_blocks()
    checked = config_with_model(load_config(config), model, resume)
    refuse_unusual(checked, str(config))
    if yes and not resume:
        raise BadConfig("--yes answers what --resume asks; give both, or leave --yes out")
    verbs: queue.SimpleQueue[OperatorCommand | AcknowledgeAll] = queue.SimpleQueue()
    by_hand = any(
        section is not None and section.driver == "operator" for section in (checked.load_frame, checked.stage, checked.sem.trigger)
    )
    if sys.stdin.isatty() and by_hand:  # other lines answer what the drivers ask
        for desk in operator_interfaces().values():
            desk.add_answer_source(partial(_taken, verbs))
    elif sys.stdin.isatty():
        threading.Thread(target=_listen, args=(verbs,), daemon=True).start()
    console = Console(stderr=True)
    place = PageAddress(page_host, page_port, tuple(page_name or ()))
    with contextlib.ExitStack() as stack:
        with ProgressView(console) as view:
            door = None if no_page else partial(_open_page, stack, view, checked.run.folder / checked.run.name, place)
            outcome = run_experiment(checked, RunInterface(view.show, verbs, attended, stop_on_fault, resume, yes, door))
        for line in (outcome.text, f"log: {outcome.log}"):
            console.print(printable(line), markup=False)
        if stay and not no_page:
            console.print("the live page stays until Ctrl-C")
            with contextlib.suppress(KeyboardInterrupt):
                threading.Event().wait()
    if not outcome.complete:
        raise SemliveError(f"the run did not complete: {outcome.text}")


def _open_page(stack: contextlib.ExitStack, view: ProgressView, log: Path, place: PageAddress, address: SocketAddress) -> None:
    """Start the page and show its address, which holds the token; a run goes on without a page that does not come up."""

    def ready(page: str | None, why: str) -> None:
        view.say(
            f"the live page does not come up ({why}); look whether its address is one of this computer"
            if page is None
            else f"live page: {page}#token={address.token}"
        )

    stack.callback(PageProcess(log, place, ready, address).close)


def _listen(verbs: queue.SimpleQueue[OperatorCommand | AcknowledgeAll]) -> None:
    """What the operator types, as verbs."""
    for line in sys.stdin:
        if not _taken(verbs, line) and line.strip():
            sys.stderr.write(f"{printable(line.strip())}: say one of {', '.join((*OperatorCommand, ACKNOWLEDGE))}\n")


def _taken(verbs: queue.SimpleQueue[OperatorCommand | AcknowledgeAll], line: str) -> bool:
    """Whether a line is a verb; a stage that a hand moves would take "stop" for the word that it is done."""
    word = line.strip().lower()
    if word == ACKNOWLEDGE:
        verbs.put(AcknowledgeAll("terminal"))
        return True
    if word not in list(OperatorCommand):
        return False
    verbs.put(OperatorCommand(word))
    return True
