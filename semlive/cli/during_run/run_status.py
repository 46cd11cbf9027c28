"""Progress of a run: one live line on a terminal, otherwise a line for each change."""

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

from semlive.engine import FINAL_STATES, State
from semlive.inputs.printable import printable
from semlive.service.control.run_monitor import RunSnapshot
from semlive.service.log.alarms import PRESS_STOP, Alarm, AlarmLevel

_MAX_QUEUED = 200
_CLOSE_TIMEOUT_S = 2.0
_START_TIMEOUT_S = 5.0
# Interval in which the alarm of a machine that does not obey its stop is shown again until it is acknowledged.
_ALARM_INTERVAL_S = 5.0


class ProgressView:
    """Shows snapshots of the run; a context manager that removes the live line at its end.

    A terminal can block writers for any time (Ctrl-S, a pipe without a reader), and the control loop must not wait for it.
    Therefore a separate thread writes; snapshots that do not fit into its queue are not shown.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = Live(console=console, refresh_per_second=8, transient=True) if console.is_terminal else None
        self._shown: tuple[object, ...] = ()
        self._remaining = RemainingTime()
        self._warnings: tuple[str, ...] = ()
        self._repeat = Repeat(_ALARM_INTERVAL_S)
        self._snapshots: queue.Queue[RunSnapshot | str | None] = queue.Queue(_MAX_QUEUED)
        self._thread = threading.Thread(target=self._run, name="progress", daemon=True)

    def __enter__(self) -> ProgressView:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with contextlib.suppress(queue.Full):
            self._snapshots.put(None, timeout=_CLOSE_TIMEOUT_S)
        self._thread.join(_CLOSE_TIMEOUT_S)

    def show(self, snapshot: RunSnapshot) -> None:
        """Show a snapshot; called with every tick, returns at once."""
        with contextlib.suppress(queue.Full):
            self._snapshots.put_nowait(snapshot)

    def show_line(self, line: str) -> None:
        """Show a line, from any thread; returns at once."""
        with contextlib.suppress(queue.Full):
            self._snapshots.put_nowait(line)

    def _run(self) -> None:
        started, lines = False, list[str]()
        # Writing to a terminal that was closed raises errors; nobody can read the text.
        with contextlib.suppress(OSError, ValueError), self._live or contextlib.nullcontext():
            while (item := self._next(bool(lines))) is not None:
                started = started or not isinstance(item, str) or not item
                if isinstance(item, RunSnapshot):
                    self._write(item)
                elif item:
                    lines.append(item)
                while started and lines:
                    self._line(lines.pop(0))

    def _next(self, waiting: bool) -> RunSnapshot | str | None:
        """Next snapshot or line; None at the end; "" if lines have waited long enough for the run to start.

        Lines are held back until the run has started, so that a refused run prints only its error message.
        """
        try:
            return self._snapshots.get(timeout=_START_TIMEOUT_S if waiting else None)
        except queue.Empty:
            return ""

    def _write(self, snapshot: RunSnapshot) -> None:
        for warning in _new(self._warnings, snapshot.warnings):
            self._line(f"! {warning}", "yellow")
        self._warnings = snapshot.warnings
        alarm = disobeyed(snapshot.alarms)
        if self._repeat.due(alarm is not None, time.monotonic()) and alarm is not None:
            self._line(f"!!! {PRESS_STOP} ({alarm.text}). When it has stopped, type acknowledge and press Enter.", "bold white on red")
        remaining_s = self._remaining.seconds(snapshot.progress.step, snapshot.progress.steps, time.monotonic())
        if self._live is not None:
            self._live.update(_panel(snapshot, remaining_s))
        key = (snapshot.progress.state, snapshot.progress.step, snapshot.progress.pair_frames_accepted, snapshot.pairs_analysed)
        if key != self._shown:
            self._shown = key
            if self._live is None or snapshot.progress.state is State.STEP_DONE:
                self._line(progress_line(snapshot, remaining_s))

    def _line(self, text: str, style: str = "") -> None:
        """Write one line without breaking it: journals break lines, and rich caches the width of the last 4,096 lines that it breaks."""
        text = printable(text)
        if self._live is not None:
            self._console.print(text, style=style, highlight=False, markup=False, soft_wrap=True)
        else:
            self._console.file.write(f"{text}\n")
            self._console.file.flush()


def disobeyed(alarms: tuple[Alarm, ...]) -> Alarm | None:
    """The newest alarm of a machine that does not obey its stop, unless acknowledged."""
    return next((alarm for alarm in reversed(alarms) if alarm.disobeyed and not alarm.acknowledged), None)


def _new(before: tuple[str, ...], now: tuple[str, ...]) -> tuple[str, ...]:
    """Items that were appended to a list of limited length, whose first items are dropped."""
    for common in range(min(len(before), len(now)), 0, -1):
        if before[-common:] == now[:common]:
            return now[common:]
    return now


class Repeat:
    """Schedule of a line that is shown repeatedly while a condition holds.

    Args:
        every_s: interval in seconds of the monotonic clock.
    """

    def __init__(self, every_s: float) -> None:
        self._every_s, self._next_s = every_s, float("-inf")

    def due(self, holds: bool, now_s: float) -> bool:
        """Whether the line is due: at once when the condition begins to hold, then after each interval."""
        if not holds:
            self._next_s = float("-inf")
            return False
        if now_s < self._next_s:
            return False
        self._next_s = now_s + self._every_s
        return True


class RemainingTime:
    """Estimate of the remaining time of a run, from the mean duration of the steps so far."""

    def __init__(self) -> None:
        self._step: int | None = None
        self._began_s = self._entered_s = 0.0
        self._first = 0

    def seconds(self, step: int, steps: int, now_s: float) -> float | None:
        """Remaining seconds of wall time; None before the first step is complete.

        Args:
            step: current step, from 0; a resumed run starts at a later one.
            steps: number of steps of the plan.
            now_s: monotonic clock.
        """
        if self._step is None:
            self._step, self._first, self._began_s, self._entered_s = step, step, now_s, now_s
        elif step != self._step:
            self._step, self._entered_s = step, now_s
        if step <= self._first:
            return None
        each_s = (self._entered_s - self._began_s) / (step - self._first)
        return max(0.0, each_s * (steps - step) - (now_s - self._entered_s))


def progress_line(snapshot: RunSnapshot, remaining_s: float | None = None) -> str:
    """A snapshot in one line, with the remaining time."""
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
    if remaining_s is not None and progress.state not in FINAL_STATES:
        parts.append(f"about {_duration(remaining_s)} left")
    return "  ".join(parts)


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{seconds:.0f} s" if seconds < 90 else f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"


def _panel(snapshot: RunSnapshot, remaining_s: float | None) -> Table:
    table = Table.grid(padding=(0, 2))
    progress = snapshot.progress
    table.add_row(
        ProgressBar(total=progress.steps, completed=progress.steps if progress.state is State.COMPLETE else progress.step, width=60)
    )
    table.add_row(Text(progress_line(snapshot, remaining_s), style="bold"))
    table.add_row(Text(printable(snapshot.progress.message or ""), style="dim"))
    if open_alarms := [alarm for alarm in snapshot.alarms if not alarm.acknowledged]:
        dangers = [alarm for alarm in open_alarms if alarm.level is AlarmLevel.DANGER]
        shown, style = (dangers[-1], "bold red") if dangers else (open_alarms[-1], "yellow")
        newest = f"{len(open_alarms)} not acknowledged, newest: {shown.text}; type acknowledge and press Enter"
        table.add_row(Text(f"alarms: {newest}", style=style))
    return table
