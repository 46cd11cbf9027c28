"""The virtual SEM: scans in experiment time, and exports each frame during the next scan."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from semlive_simulators.bench_clock import BenchClock
from semlive_simulators.exporters.export_thread import Exported, ExportThread, FinishedScan
from semlive_simulators.microscope.exposure import Exposure, row_passes
from semlive_simulators.scenario import Scenario
from semlive_simulators.specimen.machine import LoadTrain

__all__ = ["Exported", "Sem"]


class Sem:
    """A thread that scans, and threads that write files. `failed` is called when one of them fails."""

    def __init__(
        self,
        scenario: Scenario,
        clock: BenchClock,
        machine: LoadTrain,
        folder: Path,
        triggered: bool,
        exported: Callable[[Exported], None],
        failed: Callable[[BaseException], None],
    ) -> None:
        self._scenario = scenario
        self._column = scenario.column()
        self._passes = row_passes(self._column)
        self._clock = clock
        self._machine = machine
        self._triggered = triggered
        self._failed = failed
        self._stop = threading.Event()
        self._wake = threading.Condition()
        self._requested = False
        self._scanning = False
        self._export = ExportThread(scenario, clock, folder, self._stop, exported, failed)
        self._thread = threading.Thread(target=self._guarded, name="scan", daemon=True)

    @property
    def scanning(self) -> bool:
        """Whether a scan is under way or requested."""
        return self._scanning or self._requested

    @property
    def exported(self) -> int:
        """Frames completely written so far."""
        return self._export.exported

    def start(self) -> None:
        """Start all threads."""
        self._export.start()
        self._thread.start()

    def stop(self) -> None:
        """Abort the present scan, complete the files that are being written, and end."""
        self._stop.set()
        with self._wake:
            self._wake.notify_all()
        if self._thread.is_alive():
            self._thread.join(timeout=10.0)
        self._export.stop()

    def request_scan(self) -> bool:
        """Request one frame in triggered mode; False during a scan, and in continuous mode."""
        with self._wake:
            if not self._triggered or self._scanning or self._requested:
                return False
            self._requested = True
            self._wake.notify_all()
            return True

    def _guarded(self) -> None:
        try:
            self._scan_forever()
        except BaseException as error:
            self._failed(error)
            raise

    def _scan_forever(self) -> None:
        frame = 0
        start_ns = self._clock.start_ns + round(self._scenario.first_scan_s * 1e9)
        while not self._stop.is_set():
            if self._triggered:
                with self._wake:
                    self._wake.wait_for(lambda: self._requested or self._stop.is_set())
                start_ns = self._clock.now_ns()
            if not self._clock.wait_until(start_ns, self._stop):
                return
            scanned = self._scan(frame, start_ns)
            if scanned is None:
                return
            self._export.put(scanned)
            frame += 1
            start_ns = scanned.end_time_ns + round(self._scenario.scan.gap_s * 1e9)

    def _scan(self, frame: int, start_ns: int) -> FinishedScan | None:
        """Scan one frame pass by pass, each after its time has passed; None after a stop."""
        start_s = (start_ns - self._clock.start_ns) * 1e-9
        exposure = Exposure(self._column, frame, start_s)
        with self._wake:
            self._scanning, self._requested = True, False
        for row_pass in self._passes:
            due_ns = start_ns + round(row_pass.end_s * 1e9)
            self._clock.register_work("strip", due_ns)
            if not self._clock.wait_until(due_ns, self._stop):
                return None
            self._machine.advance_to(due_ns)
            exposure.expose(row_pass, self._machine.window(start_s + row_pass.begin_s, start_s + row_pass.end_s).motion)
            self._clock.done("strip")
        duration_s = self._column.duration_s
        end_ns = start_ns + round(duration_s * 1e9)
        if not self._clock.wait_until(end_ns, self._stop):  # the last row may end before the nominal end of the scan
            return None
        # Reading and window are stored now, because on a slow share the file may be written after the next move of the stage.
        reading, window = self._machine.read(end_ns), self._machine.window(start_s, start_s + duration_s)
        self._scanning = False
        return FinishedScan(frame, start_ns, end_ns, exposure.image, reading, window)
