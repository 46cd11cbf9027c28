"""How long after its last write a file is accepted: watches with and without file-system events on one folder, in real time."""

from __future__ import annotations

import dataclasses
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from semlive.data.frame import ExportedFile
from semlive.service.runtime.clock import SystemClock
from semlive.service.watch.thread import FolderWatcher
from semlive.service.watch.watch_settings import WatchSettings
from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle

from .scene import PAPER

WIDTH_PX, HEIGHT_PX, PIECES = 512, 384, 4
_TIMEOUT_S = 60.0
_PAUSE_S = (0.05, 0.25)
FORMATS = (Vendor.FEI, Vendor.ZEISS, Vendor.TESCAN, Vendor.PNG, Vendor.TIFF, Vendor.JEOL)
WATCHES = {"events": {}, "polling": {"use_events": False}, "polling, time only": {"use_events": False, "proof_after_s": 1e6}}
"""Settings of the watches that are compared; the last one awaits every file for `stable_for_s`."""


@dataclass
class Measured:
    """Latencies of one format in one watch, s, and those of its first file."""

    vendor: Vendor
    watch: str
    first_s: float = 0.0
    later_s: list[float] = field(default_factory=list)


@dataclass
class _Accepted:
    """When each file was accepted, monotonic s."""

    at_s: dict[str, float] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    changed: threading.Condition = field(default_factory=threading.Condition)

    def take(self, file: ExportedFile) -> None:
        with self.changed:
            self.at_s[file.name] = time.monotonic()
            self.changed.notify_all()

    def wait(self, count: int) -> None:
        with self.changed:
            if not self.changed.wait_for(lambda: len(self.at_s) >= count, _TIMEOUT_S):
                raise RuntimeError(f"{count - len(self.at_s)} files were not accepted: {self.problems}")


def latencies(files: int, folder: Path, seed: int, formats: tuple[Vendor, ...] = FORMATS) -> list[Measured]:
    """Write so many files of each format after a first one, and measure every watch."""
    return [row for vendor in formats for row in _measure(vendor, files, folder / f"latency-{vendor}", seed)]


def latency_table(rows: list[Measured]) -> str:
    """A table of the latencies, ms, in Markdown."""
    lines = ["| format | watch | files | first, ms | median, ms | p99, ms | largest, ms |", "|---|---|---|---|---|---|---|"]
    for row in rows:
        figures = 1e3 * np.array([row.first_s, *(np.percentile(row.later_s, part) for part in (50, 99, 100))])
        lines.append(f"| {row.vendor} | {row.watch} | {len(row.later_s)} | " + " | ".join(f"{figure:.0f}" for figure in figures) + " |")
    return "\n".join(lines)


def _measure(vendor: Vendor, files: int, folder: Path, seed: int) -> list[Measured]:
    folder.mkdir()
    rng, accepted = np.random.default_rng(seed), {name: _Accepted() for name in WATCHES}
    name = vendor if vendor == Vendor.JEOL else None
    watchers = [
        FolderWatcher(
            dataclasses.replace(WatchSettings(folder, vendor=name), **settings),
            SystemClock(),
            accepted[watch].take,
            lambda rejected, watch=watch: accepted[watch].problems.append(rejected.reason),
            accepted[watch].problems.append,
        )
        for watch, settings in WATCHES.items()
    ]
    for watcher in watchers:
        watcher.start()
    time.sleep(0.2)
    written_s: dict[str, float] = {}
    for number in range(files + 1):
        path = folder / f"x_{number:05d}{'.png' if vendor == Vendor.PNG else '.tif'}"
        written_s[path.name] = _write(path, vendor, number, rng)
        if number == 0:  # a watch learns from the first file of a run
            for watch in accepted.values():
                watch.wait(1)
        time.sleep(rng.uniform(*_PAUSE_S))
    for watch in accepted.values():
        watch.wait(files + 1)
    for watcher in watchers:
        watcher.close()
    rows: list[Measured] = []
    for watch, times in accepted.items():
        first, *later = (times.at_s[name] - written_s[name] for name in sorted(written_s))
        rows.append(Measured(vendor, watch, first, later))
    return rows


def _write(path: Path, vendor: Vendor, number: int, rng: np.random.Generator) -> float:
    """Write a file in one of the ways of microscopes; the monotonic time of its last write, s."""
    scan = dataclasses.replace(PAPER, width_px=WIDTH_PX, height_px=HEIGHT_PX, frame_time_s=HEIGHT_PX * WIDTH_PX * 1.2e-4)
    image = rng.integers(1, 256, (HEIGHT_PX, WIDTH_PX), dtype=np.uint8)
    frame = Export(WriteStyle.DIRECT, 0.0, 1.0, 1, 0, "x", vendor).encode(
        image, ImageMetadata(scan, time.time_ns(), 0, 0, number, path.name)
    )
    if frame.sidecar is not None:
        path.with_suffix(".txt").write_bytes(frame.sidecar)
    style = (_direct, _preallocated, _renamed)[number % 3]
    style(path, frame.image, partial(time.sleep, float(rng.uniform(0.0, 0.05))))
    return time.monotonic()


def _direct(path: Path, data: bytes, pause: Callable[[], None]) -> None:
    with path.open("wb", buffering=0) as stream:
        for part in range(PIECES):
            stream.write(data[len(data) * part // PIECES : len(data) * (part + 1) // PIECES])
            if part < PIECES - 1:
                pause()


def _preallocated(path: Path, data: bytes, pause: Callable[[], None]) -> None:
    path.write_bytes(bytes(len(data)))
    pause()
    with path.open("r+b", buffering=0) as stream:
        stream.write(data)


def _renamed(path: Path, data: bytes, pause: Callable[[], None]) -> None:
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_bytes(data)
    pause()
    os.replace(temporary, path)
