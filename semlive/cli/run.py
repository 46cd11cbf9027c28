"""`semlive run`: the daemon in the foreground of a terminal."""

from __future__ import annotations

import queue
import sys
import threading
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from semlive.cli.progress import ProgressView
from semlive.engine import Verb
from semlive.errors import SemliveError
from semlive.service.config import load_config
from semlive.service.daemon import Faces, run_experiment


def run(
    config: Annotated[Path, typer.Argument(help="YAML configuration of the run.")],
    attended: Annotated[bool, typer.Option("--attended", help="You stay at the instrument; real load frames ask for it.")] = False,
    stop_on_fault: Annotated[bool, typer.Option("--stop-on-fault", help="End the run at a fault instead of waiting for you.")] = False,
) -> None:
    """Run an experiment; type pause, resume, stop or abort and press Enter, or Ctrl-C to stop."""
    checked = load_config(config)
    verbs: queue.SimpleQueue[Verb] = queue.SimpleQueue()
    interactive = sys.stdin.isatty() and (checked.stage is None or checked.stage.driver != "operator")
    if interactive:
        threading.Thread(target=_listen, args=(verbs,), daemon=True).start()
    console = Console(stderr=True)
    with ProgressView(console) as view:
        outcome = run_experiment(checked, Faces(view.show, verbs, attended, stop_on_fault))
    console.print(f"{outcome.text}\nlog: {outcome.log}")
    if not outcome.complete:
        raise SemliveError(f"the run did not complete: {outcome.text}")


def _listen(verbs: queue.SimpleQueue[Verb]) -> None:
    """What the operator types, as verbs."""
    for line in sys.stdin:
        word = line.strip().lower()
        if word in list(Verb):
            verbs.put(Verb(word))
        elif word:
            sys.stderr.write(f"{word}: say one of {', '.join(Verb)}\n")
