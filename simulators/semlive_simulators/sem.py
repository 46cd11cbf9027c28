"""The virtual SEM at work: it scans as time passes and exports each frame while the next one runs."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semlive_simulators.clockwork import BenchClock
from semlive_simulators.exporters.facts import ImageFacts
from semlive_simulators.exporters.writing import plan_files, write_file
from semlive_simulators.machine import Machine
from semlive_simulators.scenario import Scenario

STRIP_ROWS = 16
"""Rows rendered at a time: 1.7 s of experiment time at x200, 1 ms of work."""


@dataclass(frozen=True, slots=True, eq=False)
class Exported:
    """A frame whose scan is over.

    Attributes:
        file: its name in the export folder.
        frame: number of the scan, from 0.
        start_time_ns: when it began, UTC ns.
        image: (height, width) of the detector's dtype.
    """

    file: str
    frame: int
    start_time_ns: int
    image: NDArray[np.unsignedinteger]


class Sem:
    """Two threads: one scans, one writes files. `failed` is called when either dies of an error."""

    def __init__(
        self,
        scenario: Scenario,
        clock: BenchClock,
        machine: Machine,
        folder: Path,
        triggered: bool,
        exported: Callable[[Exported], None],
        failed: Callable[[BaseException], None],
    ) -> None:
        self._scenario = scenario
        self._column = scenario.column()
        self._clock = clock
        self._machine = machine
        self._folder = folder
        self._triggered = triggered
        self._on_exported = exported
        self._failed = failed
        self._stop = threading.Event()
        self._wake = threading.Condition()
        self._requested = False
        self._scanning = False
        self._exported = 0
        self._finished: queue.SimpleQueue[Exported | None] = queue.SimpleQueue()
        self._threads = [
            threading.Thread(target=self._guarded, args=(work,), name=name, daemon=True)
            for name, work in (("scan", self._scan_forever), ("export", self._export_forever))
        ]

    @property
    def scanning(self) -> bool:
        """Whether the beam is scanning a frame, or was just told to."""
        return self._scanning or self._requested

    @property
    def exported(self) -> int:
        """Frames completely written so far."""
        return self._exported

    def start(self) -> None:
        """Begin."""
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Give up the scan that runs, finish the file that is being written, end."""
        self._stop.set()
        with self._wake:
            self._wake.notify_all()
        self._finished.put(None)
        for thread in self._threads:
            thread.join(timeout=10.0)

    def request_scan(self) -> bool:
        """Ask for one frame in triggered mode; False while scanning, and in continuous mode."""
        with self._wake:
            if not self._triggered or self._scanning or self._requested:
                return False
            self._requested = True
            self._wake.notify_all()
            return True

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:
            self._failed(error)
            raise

    def _scan_forever(self) -> None:
        scan = self._scenario.scan
        frame = 0
        start_ns = self._clock.start_ns + round(self._scenario.first_scan_s * 1e9)
        while not self._stop.is_set():
            if self._triggered:
                with self._wake:
                    self._wake.wait_for(lambda: self._requested or self._stop.is_set())
                start_ns = self._clock.now_ns()
            if not self._clock.wait_until(start_ns, self._stop):
                return
            image = self._scan(frame, start_ns)
            if image is None:
                return
            name = self._scenario.export.file_name(frame)
            self._finished.put(Exported(name, frame, start_ns, image))
            frame += 1
            start_ns += round((self._column.duration_s + scan.gap_s) * 1e9)

    def _scan(self, frame: int, start_ns: int) -> NDArray[np.unsignedinteger] | None:
        """Scan one frame in strips, each when its time has passed; None if told to stop."""
        scan = self._scenario.scan
        start_s = (start_ns - self._clock.start_ns) * 1e-9
        image = np.empty((scan.height_px, scan.width_px), dtype=self._scenario.detector.dtype)
        with self._wake:
            self._scanning, self._requested = True, False
        for first in range(0, scan.height_px, STRIP_ROWS):
            rows = image[first : first + STRIP_ROWS]
            begin_s, end_s = self._column.rows_span_s(first, first + rows.shape[0])
            due_ns = start_ns + round(end_s * 1e9)
            self._clock.expect("strip", due_ns)
            if not self._clock.wait_until(due_ns, self._stop):
                return None
            self._machine.advance_to(due_ns)
            window = self._machine.window(start_s + begin_s, (due_ns - self._clock.start_ns) * 1e-9)
            self._column.render_rows(rows, first, start_s, window.motion, frame)
            self._clock.done("strip")
        self._scanning = False
        return image

    def _export_forever(self) -> None:
        while (item := self._finished.get()) is not None:
            self._export(item)

    def _export(self, item: Exported) -> None:
        """Write a frame's files bit by bit, as slowly as an instrument does; a stop only makes it hurry."""
        export, scan = self._scenario.export, self._scenario.scan
        end_ns = item.start_time_ns + round(scan.duration_s * 1e9)
        reading = self._machine.read(end_ns)
        told_ns = self._scenario.told_ns(end_ns, self._clock.start_ns)
        facts = ImageFacts(scan, told_ns, reading.encoder_x_um, reading.encoder_y_um, item.frame, item.file)

        @contextlib.contextmanager
        def at(since_end_s: float) -> Iterator[None]:
            due_ns = end_ns + round(since_end_s * 1e9)
            self._clock.expect("export", due_ns)
            self._clock.wait_until(due_ns, self._stop)
            yield
            self._clock.done("export")

        for plan in plan_files(export.encode(item.image, facts), item.file, export):
            write_file(plan, self._folder, end_ns, at)
        self._exported += 1
        self._on_exported(item)
