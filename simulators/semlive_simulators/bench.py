"""The bench: virtual SEM, load frame and specimen stage in one process.

It listens on Modbus TCP, publishes experiment time in ``clock.json``, then its addresses in ``ready.json``, exports images into
``export/`` and writes ``truth.json``, which only a score may read.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import os
import signal
import statistics
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from semlive.data.clock import Clock
from semlive.formats.tables.clock_file import encode_clock
from semlive_simulators.bench_clock import BenchClock
from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.kernels.pattern import gaussian
from semlive_simulators.load_frame.rtu import STAGE_UNIT
from semlive_simulators.load_frame.serial_lines import ascii_line, rtu_line
from semlive_simulators.load_frame.server import UNIT, BenchRegisters, ModbusThread
from semlive_simulators.microscope.exposure import Exposure, row_passes
from semlive_simulators.microscope.sem import Exported, Sem
from semlive_simulators.scenario import BadScenario, Scenario, load_scenario
from semlive_simulators.specimen.machine import LoadTrain
from semlive_simulators.specimen.specimen import at_rest
from semlive_simulators.truth import TruthRecorder, frame_truth

TICK_S = 0.02
MAX_RATE = 40.0
"""Largest automatic rate: a frame of 94.67 s then takes 2.4 s of wall time, and its correlation in a daemon about 1 s."""
_MAX_LOAD = 0.5
"""Largest fraction of its time in which the scanning thread works; the rest is for other processes."""


def write_atomically(path: Path, data: bytes) -> None:
    """Replace a file so that a reader gets the complete old or the complete new content."""
    working = path.with_name(path.name + ".new")
    working.write_bytes(data)
    for _ in range(100):
        with contextlib.suppress(PermissionError):
            os.replace(working, path)
            return
        time.sleep(0.002)  # Windows refuses while another process reads the old file
    os.replace(working, path)


class Bench:
    """The parts of the bench and their connections."""

    def __init__(
        self, scenario: Scenario, out: Path, rate: float | None, port: int, triggered: bool, lines: frozenset[str] = frozenset()
    ) -> None:
        self._scenario = scenario
        self._lines = lines
        self._out = out
        self._export = out / "export"
        self._export.mkdir(parents=True, exist_ok=True)
        self._triggered = triggered
        self._stopped = False
        self._failure: BaseException | None = None
        _warm_up(scenario)
        self._rate = _sustainable_rate(scenario) if rate is None else rate
        self._clock = BenchClock(self._rate, self._publish)
        self._machine = LoadTrain(scenario, self._clock.start_ns)
        self._truth = TruthRecorder(scenario, self._clock.start_ns)
        self._sem = Sem(scenario, self._clock, self._machine, self._export, triggered, self._frame_exported, self._fail)
        self._registers = BenchRegisters(scenario, self._clock, self._machine, self._sem)
        self._modbus = ModbusThread(self._registers, port)

    def _publish(self, clock: Clock) -> None:
        write_atomically(self._out / "clock.json", encode_clock(clock))

    def _fail(self, error: BaseException) -> None:
        self._failure = error
        self.stop()

    def stop(self) -> None:
        """Request the end of the bench; from any thread, and in a signal handler.

        A signal handler cannot set an event: if its thread waits for the same event, the lock of the event is held and never released.
        """
        self._stopped = True

    def run(self) -> int:
        """Serve until stopped; returns the exit code."""
        port = self._modbus.start()
        try:
            with contextlib.ExitStack() as stack:
                self._serve(port, stack)
        finally:
            self._sem.stop()
            self._modbus.stop()
            self._write_truth()
        if self._failure is not None:
            sys.stderr.write(f"bench: stopped by {type(self._failure).__name__}: {self._failure}\n")
            return 1
        return 0

    def _serve(self, port: int, stack: contextlib.ExitStack) -> None:
        ready, stand = self._ready(port), None
        if "rtu" in self._lines:
            ready["rtu_stage_unit"] = STAGE_UNIT
            ready["rtu_port"] = stack.enter_context(rtu_line(port, UNIT, self._registers.line_faults))
        if "serial" in self._lines:
            ready["serial_port"], stand = stack.enter_context(ascii_line(self._machine, self._clock.now_ns, self._registers.line_faults))
        self._clock.begin()
        self._write_truth()
        write_atomically(self._out / "ready.json", (json.dumps(ready, indent=2) + "\n").encode())
        self._sem.start()
        while not self._stopped:
            time.sleep(TICK_S)
            self._machine.advance_to(self._clock.now_ns())
            if self._registers.watchdog.expired:
                self._machine.trip_watchdog()
            if stand is not None:
                stand.watch_limits()

    def _ready(self, port: int) -> dict[str, object]:
        return {
            "host": "127.0.0.1",
            "port": port,
            "unit": UNIT,
            "export_folder": str(self._export),
            "clock_file": str(self._out / "clock.json"),
            "truth_file": str(self._out / "truth.json"),
            "pixel_size_m": self._scenario.scan.pixel_size_um / 1e6,
            "rate": self._rate,
            "shifts_by": self._scenario.shifts_by.value,
            "mode": "triggered" if self._triggered else "continuous",
            "scenario": self._scenario.name,
            "experiment": self._scenario.experiment,
        }

    def _frame_exported(self, item: Exported) -> None:
        start_s = (item.start_time_ns - self._clock.start_ns) * 1e-9
        window = item.window
        self._truth.add_frame(
            frame_truth(self._scenario, item.file, item.start_time_ns, start_s, window.motion, window.force_mean_n, window.moving),
            window.motion.history,
        )
        self._write_truth()

    def _write_truth(self) -> None:
        data = self._truth.encode(self._clock.now_ns(), self._clock.stretches, self._clock.worst_lag_s)
        write_atomically(self._out / "truth.json", data)


def _warm_up(scenario: Scenario) -> None:
    """Compile or load the kernels, and run code that is slow the first time, before the clock starts."""
    column = scenario.column()
    exposure = Exposure(column, 0, 0.0)
    for row_pass in row_passes(column):
        if row_pass.first_row == 0:  # every visit of one band, including the last one, which digitises
            exposure.expose(row_pass, at_rest())
    image = np.zeros((scenario.scan.height_px, scenario.scan.width_px), dtype=scenario.detector.dtype)
    scenario.export.encode(image, ImageMetadata(scenario.scan, 0, 0.0, 0.0, 0))
    gaussian(scenario.seed, 0, 0)
    # A full garbage collection after compiler and imports takes about 50 ms: 2 s of experiment time at rate 40.
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(5e-4)


def _sustainable_rate(scenario: Scenario) -> float:
    """The largest rate, up to `MAX_RATE`, at which this computer renders frames as they are scanned; after `_warm_up`."""
    column = scenario.column()
    passes = row_passes(column)
    exposure, sample = Exposure(column, 0, 0.0), passes[len(passes) // 2 : len(passes) // 2 + 4]
    seconds = []
    for _ in range(5):
        begin_s = time.perf_counter()
        for row_pass in sample:
            exposure.expose(row_pass, at_rest())
        seconds.append((time.perf_counter() - begin_s) / len(sample))
    return min(MAX_RATE, round(_MAX_LOAD * column.duration_s / (statistics.median(seconds) * len(passes)), 1) or 0.1)


def _stop_at_end_of_input(bench: Bench) -> None:
    # Not through sys.stdin: a thread that waits in its buffer holds a lock that the interpreter needs at exit.
    with contextlib.suppress(OSError):
        while os.read(0, 4096):
            pass
    bench.stop()


def _rate(text: str) -> float | None:
    return None if text == "auto" else float(text)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="bench", description="Virtual SEM, load frame and specimen stage.")
    parser.add_argument("--scenario", default="paper_x200", help="name of a scenario, or a path ending in .yaml")
    parser.add_argument("--out", type=Path, required=True, help="folder for clock.json, ready.json, truth.json and export/")
    parser.add_argument("--rate", type=_rate, default=1.0, help="experiment seconds per wall second, or auto: as fast as frames render")
    parser.add_argument("--port", type=int, default=0, help="TCP port on 127.0.0.1; 0 takes a free one")
    parser.add_argument("--mode", choices=("continuous", "triggered"), default="continuous")
    parser.add_argument("--seed", type=int, default=None, help="replaces the seed of the scenario")
    parser.add_argument("--rtu", action="store_true", help="serve the registers as Modbus RTU too, over a pseudo-terminal")
    parser.add_argument("--serial", action="store_true", help="serve the load frame as a serial test stand too, over a pseudo-terminal")
    parser.add_argument("--exit-with-stdin", action="store_true", help="end when standard input is closed")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the bench until SIGINT or SIGTERM; exit code 0, 1 for a failure during the run, 2 for bad input."""
    options = _parser().parse_args(argv)
    if options.rate is not None and not 0 < options.rate < float("inf"):
        sys.stderr.write(f"bench: --rate must be auto or a number > 0, not {options.rate}\n")
        return 2
    if sys.platform == "win32" and (options.rtu or options.serial):
        sys.stderr.write("bench: --rtu and --serial need pseudo-terminals, which Windows does not have; leave them out\n")
        return 2
    try:
        scenario = load_scenario(options.scenario, options.seed)
        lines = frozenset(name for name in ("rtu", "serial") if getattr(options, name))
        bench = Bench(scenario, options.out.resolve(), options.rate, options.port, options.mode == "triggered", lines)
    except BadScenario as error:
        sys.stderr.write(f"bench: {error}\n")
        return 2
    except OSError as error:
        sys.stderr.write(f"bench: {options.out}: {error.strerror}; give a folder that can be written\n")
        return 2
    for signal_number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signal_number, lambda *_: bench.stop())
    if options.exit_with_stdin:
        threading.Thread(target=_stop_at_end_of_input, args=(bench,), daemon=True).start()
    try:
        return bench.run()
    except RuntimeError as error:
        sys.stderr.write(f"bench: {error}\n")
        return 2


if __name__ == "__main__":
    sys.exit(main())
