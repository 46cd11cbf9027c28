"""Progress of a run in the terminal: one live line, or a line for each change where there is no terminal."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from semlive.data.text import printable
from semlive.engine import FINAL_STATES, State
from semlive.service.control.run_monitor import RunSnapshot
from semlive.service.log.alarms import PRESS_STOP, Alarm

_MAX_WAITING = 200
_TIDY_S = 2.0
_BEGUN_S = 5.0
# An alarm that the machine does not obey is shown again after so long, for as long as nobody acknowledges it.
_LOUD_EVERY_S = 5.0


class ProgressView:
    """Shows snapshots; a context, so that the terminal is left tidy.

    A terminal may take no text for as long as it likes (Ctrl-S, a pipe that nobody reads), and the loop must not wait for
    it: a thread of its own writes, and what it cannot keep up with is not shown.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = Live(console=console, refresh_per_second=8, transient=True) if console.is_terminal else None
        self._shown: tuple[object, ...] = ()
        self._pace = RemainingTime()
        self._warnings: tuple[str, ...] = ()
        self._repeat = Repeat(_LOUD_EVERY_S)
        self._snapshots: queue.Queue[RunSnapshot | str | None] = queue.Queue(_MAX_WAITING)
        self._thread = threading.Thread(target=self._run, name="progress", daemon=True)

    def __enter__(self) -> ProgressView:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with contextlib.suppress(queue.Full):
            self._snapshots.put(None, timeout=_TIDY_S)
        self._thread.join(_TIDY_S)

    def show(self, snapshot: RunSnapshot) -> None:
        """Show a snapshot; called with every tick, returns at once."""
        with contextlib.suppress(queue.Full):
            self._snapshots.put_nowait(snapshot)

    def say(self, line: str) -> None:
        """Show a line, from any thread; returns at once."""
        with contextlib.suppress(queue.Full):
            self._snapshots.put_nowait(line)

    def _run(self) -> None:
        begun, lines = False, list[str]()
        # A terminal that was closed refuses every word; nobody is there to be told.
        with contextlib.suppress(OSError, ValueError), self._live or contextlib.nullcontext():
            while (said := self._next(bool(lines))) is not None:
                begun = begun or not isinstance(said, str) or not said
                if isinstance(said, RunSnapshot):
                    self._write(said)
                elif said:
                    lines.append(said)
                while begun and lines:
                    self._line(lines.pop(0))

    def _next(self, waiting: bool) -> RunSnapshot | str | None:
        """What is to be shown next; nothing ("") where lines have waited long enough for the run to begin.

        A run that is refused says one sentence; lines that were said before it began would stand in front of that.
        """
        try:
            return self._snapshots.get(timeout=_BEGUN_S if waiting else None)
        except queue.Empty:
            return ""

    def _write(self, snapshot: RunSnapshot) -> None:
        for warning in _new(self._warnings, snapshot.warnings):
            self._line(f"! {warning}", "yellow")
        self._warnings = snapshot.warnings
        alarm = disobeyed(snapshot.alarms)
        if self._repeat.due(alarm is not None, time.monotonic()) and alarm is not None:
            self._line(f"!!! {PRESS_STOP} ({alarm.text}). When it rests, type acknowledge and press Enter.", "bold white on red")
        left_s = self._pace.left_s(snapshot.progress.step, snapshot.progress.steps, time.monotonic())
        if self._live is not None:
            self._live.update(_panel(snapshot, left_s))
        key = (snapshot.progress.state, snapshot.progress.step, snapshot.progress.pair_frames_accepted, snapshot.pairs_analysed)
        if key != self._shown:
            self._shown = key
            if self._live is None or snapshot.progress.state is State.STEP_DONE:
                self._line(progress_line(snapshot, left_s))

    def _line(self, text: str, style: str = "") -> None:
        """One line, as it is: a journal breaks lines itself, and rich remembers the width of the last 4,096 that it broke."""
        text = printable(text)
        if self._live is not None:
            self._console.print(text, style=style, highlight=False, markup=False, soft_wrap=True)
        else:
            self._console.file.write(f"{text}\n")
            self._console.file.flush()


def disobeyed(alarms: tuple[Alarm, ...]) -> Alarm | None:
    """The newest open alarm that says that the machine does not obey its stop."""
    return next((alarm for alarm in reversed(alarms) if alarm.disobeyed and not alarm.acknowledged), None)


def _new(before: tuple[str, ...], now: tuple[str, ...]) -> tuple[str, ...]:
    """What was added at the end of a list that forgets its beginning."""
    for known in range(min(len(before), len(now)), 0, -1):
        if before[-known:] == now[:known]:
            return now[known:]
    return now


class Repeat:
    """When a line is due that is shown again and again while something lasts.

    Args:
        every_s: of this computer's time.
    """

    def __init__(self, every_s: float) -> None:
        self._every_s, self._next_s = every_s, float("-inf")

    def due(self, lasts: bool, now_s: float) -> bool:
        """Whether the line is to be shown now: at once when it begins to last, then again after each interval."""
        if not lasts:
            self._next_s = float("-inf")
            return False
        if now_s < self._next_s:
            return False
        self._next_s = now_s + self._every_s
        return True


class RemainingTime:
    """How long a run may still take: as long for each step as the steps took so far."""

    def __init__(self) -> None:
        self._step: int | None = None
        self._began_s = self._entered_s = 0.0
        self._first = 0

    def left_s(self, step: int, steps: int, now_s: float) -> float | None:
        """Seconds of this computer's time, None before the first step is done.

        Args:
            step: that the run is at, from 0; it may have been taken up at a later one.
            steps: of the plan.
            now_s: this computer's time.
        """
        if self._step is None:
            self._step, self._first, self._began_s, self._entered_s = step, step, now_s, now_s
        elif step != self._step:
            self._step, self._entered_s = step, now_s
        if step <= self._first:
            return None
        each_s = (self._entered_s - self._began_s) / (step - self._first)
        return max(0.0, each_s * (steps - step) - (now_s - self._entered_s))


def progress_line(snapshot: RunSnapshot, left_s: float | None = None) -> str:
    """A snapshot in one line, with the time that is left."""
    progress = snapshot.progress
    parts = [f"step {progress.step + 1}/{progress.steps} {progress.phase.value}", progress.state.value]
    if progress.hold_remaining_s is not None:
        parts.append(f"hold {progress.hold_remaining_s:.0f} s left")
    if progress.state is State.IMAGING:
        parts.append(f"frame {progress.pair_frames_accepted + 1} of the pair")
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
    if left_s is not None and progress.state not in FINAL_STATES:
        parts.append(f"about {_length(left_s)} left")
    return "  ".join(parts)


def _length(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{seconds:.0f} s" if seconds < 90 else f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"


def _panel(snapshot: RunSnapshot, left_s: float | None) -> Table:
    table = Table.grid(padding=(0, 2))
    progress = snapshot.progress
    table.add_row(
        ProgressBar(total=progress.steps, completed=progress.steps if progress.state is State.COMPLETE else progress.step, width=60)
    )
    table.add_row(Text(progress_line(snapshot, left_s), style="bold"))
    table.add_row(Text(printable(snapshot.progress.message or ""), style="dim"))
    if open_alarms := [alarm for alarm in snapshot.alarms if not alarm.acknowledged]:
        newest = f"{len(open_alarms)} not acknowledged, newest: {open_alarms[-1].text}; type acknowledge and press Enter"
        table.add_row(Text(f"alarms: {newest}", style="bold red"))
    return table
