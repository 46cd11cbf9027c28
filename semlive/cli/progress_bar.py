"""How far a long job is, on standard error: a bar with the time left on a terminal, a line now and then without one."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from semlive.data.settings import DicSettings

_EVERY_S = 10.0
_LOOK_S = 0.2


@contextmanager
def progress_bar(what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """A function to be told how many of how many are done; what was printed is tidy when the context ends.

    Args:
        what: the job, as in "importing".
        unit: what is counted, as in "pair".
    """
    console = Console(stderr=True)
    if console.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn(unit + "s, left"), TimeRemainingColumn())
        with Progress(*columns, console=console, transient=True) as progress:
            task = progress.add_task(what)
            yield lambda done, count: progress.update(task, completed=done, total=count)
        return
    yield _Lines(what, unit).tell


@contextmanager
def multi_stage_progress(*, quiet: bool = False) -> Iterator[Callable[[str, int, int], None] | None]:
    """The same for a job of several stages, each told by what it counts.

    Args:
        quiet: tell nothing, where results are printed as they come.
    """
    if quiet:
        yield None
        return
    console = Console(stderr=True)
    if console.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("left"), TimeRemainingColumn())
        with Progress(*columns, console=console, transient=True) as progress:
            tasks: dict[str, TaskID] = {}

            def show(stage: str, done: int, count: int) -> None:
                if stage not in tasks:
                    tasks[stage] = progress.add_task(f"{stage}s")
                progress.update(tasks[stage], completed=done, total=count)

            yield show
        return
    lines: dict[str, _Lines] = {}
    yield lambda stage, done, count: lines.setdefault(stage, _Lines("replay", stage)).tell(done, count)


def compile_with_progress(settings: DicSettings) -> None:
    """Compile the kernels, or load them; half a minute the first time."""
    from semlive.dic import warm_up  # noqa: PLC0415  (asks for a second of imports, and compiles)
    from semlive.kernels.compile_progress import compile_progress  # noqa: PLC0415

    with ThreadPoolExecutor(1) as worker, progress_bar("compiling", "kernel") as progress:
        job = worker.submit(warm_up, settings)
        while wait([job], _LOOK_S).not_done:
            progress(*compile_progress())
        job.result()


class _Lines:
    """A line every ten seconds."""

    def __init__(self, what: str, unit: str) -> None:
        self._what, self._unit = what, unit
        self._began = self._told = time.monotonic()

    def tell(self, done: int, count: int) -> None:
        now = time.monotonic()
        if now - self._told < _EVERY_S or done == 0:
            return
        self._told = now
        left_s = (now - self._began) / done * (count - done)
        sys.stderr.write(f"{self._what}: {self._unit} {done} of {count}, {left_s:.0f} s left\n")
