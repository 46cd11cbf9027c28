"""Progress of a long job on standard error: a bar with the remaining time on a terminal, otherwise a line every ten seconds."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from semlive.data.settings import DicSettings

_LINE_INTERVAL_S = 10.0
_POLL_INTERVAL_S = 0.2


@contextmanager
def progress_bar(what: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """Give a function that shows progress; its arguments are the number of completed units and their total.

    Args:
        what: name of the job, as in "importing".
        unit: unit that is counted, as in "pair".
    """
    console = Console(stderr=True)
    if console.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn(unit + "s, left"), TimeRemainingColumn())
        with Progress(*columns, console=console, transient=True) as progress:
            task = progress.add_task(what)
            yield lambda done, count: progress.update(task, completed=done, total=count)
        return
    yield _Lines(what, unit).update


@contextmanager
def multi_stage_progress(*, hidden: bool = False) -> Iterator[Callable[[str, int, int], None] | None]:
    """Like `progress_bar` for a job of several stages; the function takes the counted unit, which identifies the stage, first.

    Args:
        hidden: give None instead of a function, for commands that print results as they arrive.
    """
    if hidden:
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
    yield lambda stage, done, count: lines.setdefault(stage, _Lines("replay", stage)).update(done, count)


def compile_with_progress(settings: DicSettings) -> None:
    """Compile the kernels, or load them from the cache; compiling takes half a minute."""
    from semlive.dic import warm_up  # noqa: PLC0415  (the import takes a second, and compiles)
    from semlive.kernels.compile_progress import compile_progress  # noqa: PLC0415

    with ThreadPoolExecutor(1) as worker, progress_bar("compiling", "kernel") as progress:
        job = worker.submit(warm_up, settings)
        while wait([job], _POLL_INTERVAL_S).not_done:
            progress(*compile_progress())
        job.result()


class _Lines:
    """Writes a line every ten seconds."""

    def __init__(self, what: str, unit: str) -> None:
        self._what, self._unit = what, unit
        self._began = self._last_line = time.monotonic()

    def update(self, done: int, count: int) -> None:
        now = time.monotonic()
        if now - self._last_line < _LINE_INTERVAL_S or done == 0:
            return
        self._last_line = now
        remaining_s = (now - self._began) / done * (count - done)
        sys.stderr.write(f"{self._what}: {self._unit} {done} of {count}, {remaining_s:.0f} s left\n")
