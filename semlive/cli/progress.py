"""Progress of a run in the terminal: one live line, or a line for each change where there is no terminal."""

from __future__ import annotations

import contextlib
import queue
import threading
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from semlive.engine import State
from semlive.service.control import Snapshot

_MAX_WAITING = 200
_TIDY_S = 2.0


class ProgressView:
    """Shows snapshots; a context, so that the terminal is left tidy.

    A terminal may take no text for as long as it likes (Ctrl-S, a pipe that nobody reads), and the loop must not wait for
    it: a thread of its own writes, and what it cannot keep up with is not shown.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = Live(console=console, refresh_per_second=8, transient=True) if console.is_terminal else None
        self._shown: tuple[object, ...] = ()
        self._warnings: tuple[str, ...] = ()
        self._snapshots: queue.Queue[Snapshot | None] = queue.Queue(_MAX_WAITING)
        self._thread = threading.Thread(target=self._run, name="progress", daemon=True)

    def __enter__(self) -> ProgressView:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with contextlib.suppress(queue.Full):
            self._snapshots.put(None, timeout=_TIDY_S)
        self._thread.join(_TIDY_S)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot; called with every tick, returns at once."""
        with contextlib.suppress(queue.Full):
            self._snapshots.put_nowait(snapshot)

    def _run(self) -> None:
        # A terminal that was closed refuses every word; nobody is there to be told.
        with contextlib.suppress(OSError, ValueError), self._live or contextlib.nullcontext():
            while (snapshot := self._snapshots.get()) is not None:
                self._write(snapshot)

    def _write(self, snapshot: Snapshot) -> None:
        for warning in _new(self._warnings, snapshot.warnings):
            self._console.print(f"! {warning}", style="yellow", highlight=False)
        self._warnings = snapshot.warnings
        if self._live is not None:
            self._live.update(_panel(snapshot))
        key = (snapshot.progress.state, snapshot.progress.step, snapshot.progress.frames_of_pair, snapshot.pairs_analysed)
        if key != self._shown:
            self._shown = key
            if self._live is None or snapshot.progress.state is State.STEP_DONE:
                self._console.print(progress_line(snapshot), highlight=False)


def _new(before: tuple[str, ...], now: tuple[str, ...]) -> tuple[str, ...]:
    """What was added at the end of a list that forgets its beginning."""
    for known in range(min(len(before), len(now)), 0, -1):
        if before[-known:] == now[:known]:
            return now[known:]
    return now


def progress_line(snapshot: Snapshot) -> str:
    """A snapshot in one line."""
    progress = snapshot.progress
    parts = [f"step {progress.step + 1}/{progress.steps} {progress.phase.value}", progress.state.value]
    if progress.hold_left_s is not None:
        parts.append(f"hold {progress.hold_left_s:.0f} s left")
    if progress.state is State.IMAGING:
        parts.append(f"frame {progress.frames_of_pair + 1} of the pair")
    if progress.load_n is not None:
        parts.append(f"load {progress.load_n:.0f} N")
    if snapshot.pairs_analysed:
        parts.append(f"{snapshot.pairs_analysed} pairs analysed")
    if snapshot.drift_rate_px_s is not None:
        x, y = (rate * 60 for rate in snapshot.drift_rate_px_s)
        parts.append(f"drift {x:+.3f} {y:+.3f} px/min")
    elastic = snapshot.elastic
    if elastic is not None and elastic.youngs_modulus_gpa is not None and elastic.poissons_ratio is not None:
        modulus, ratio = elastic.youngs_modulus_gpa, elastic.poissons_ratio
        parts.append(f"E {modulus.value:.1f} ± {modulus.sigma:.1f} GPa, nu {ratio.value:.3f} ± {ratio.sigma:.3f}")
    if elastic is not None and elastic.gage is not None:
        parts.append(f"DIC/gage {elastic.gage.dic_over_gage.value:.3f} ± {elastic.gage.dic_over_gage.sigma:.3f}")
    return "  ".join(parts)


def _panel(snapshot: Snapshot) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_row(Text(progress_line(snapshot), style="bold"))
    table.add_row(Text(snapshot.progress.message or "", style="dim"))
    return table
