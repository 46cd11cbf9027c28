"""How fast a log takes images, compared with plain writes of the same bytes to the same disk in the same run.

    python tests/benchmarks/bench_record.py [--images 60] [--mb 1] [--rounds 7] [--folder FOLDER]

Each image is on the disk before the next one comes: written, flushed, synced (fsync). Three ways take turns, image by image, because a
disk has its moods; a round's ratio is that of the times that its images took:

* plain: one file, write and fsync per image;
* writer: the log's writer and its file, in the same thread: announced, written, flushed and synced per image;
* recorder: the recorder as the daemon uses it, a thread behind a queue; telemetry comes in between, and each image is waited for.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from semlive.formats.log.messages import SEM_ORIGINAL, FileMessage, LogLineMessage
from semlive.formats.log.writer import LogWriter
from semlive.service.log.recording import Recorder
from semlive.service.log.recording.stream import BufferedLogStream, open_new
from semlive.service.runtime.clock import SystemClock

BAR = 0.6


def announced(number: int, size: int) -> FileMessage:
    """What goes before an image."""
    return FileMessage(
        export=number, name=f"{number:04d}.tif", size=size, sha256="0" * 64, mtime_ns=0, arrival_time_ns=0, decision="arrived", reason=""
    )


class Plain:
    """Write and fsync, nothing else."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL)

    def take(self, _: int, image: bytes) -> None:
        """Bring an image to the disk."""
        view = memoryview(image)
        while view:
            view = view[os.write(self._file, view) :]
        os.fsync(self._file)

    def close(self) -> None:
        """No more images."""
        os.close(self._file)


class ByWriter:
    """The log without its thread."""

    def __init__(self, path: Path) -> None:
        self._stream = BufferedLogStream(open_new(path))
        self._writer = LogWriter(self._stream.as_binary())

    def take(self, number: int, image: bytes) -> None:
        """Bring an image to the disk."""
        self._writer.write("/sem/file", announced(number, len(image)), number, number)
        self._writer.write(SEM_ORIGINAL, image, number, number, number)
        self._writer.flush()
        self._stream.sync()

    def close(self) -> None:
        """No more images."""
        self._writer.finish()
        self._stream.sync()
        self._stream.close()


class ByRecorder:
    """The log as the daemon writes it."""

    def __init__(self, path: Path) -> None:
        self._recorder = Recorder(path, SystemClock(), sys.exit)

    def take(self, number: int, image: bytes) -> None:
        """Bring an image to the disk."""
        self._recorder.write("/log", LogLineMessage(time_ns=number, level="info", text="telemetry"))
        self._recorder.write("/sem/file", announced(number, len(image)))
        self._recorder.write(SEM_ORIGINAL, image, sequence=number)
        if not self._recorder.flush(60.0):
            sys.exit("the disk did not take an image within a minute")

    def close(self) -> None:
        """No more images."""
        self._recorder.close()


WAYS = {"plain": Plain, "writer": ByWriter, "recorder": ByRecorder}


def measured(folder: Path, count: int, size: int, rounds: int) -> tuple[dict[str, list[float]], dict[str, list[float]]]:
    """MB per wall second of each way and round, and their ratios to the plain writes of the same round."""
    rng = np.random.default_rng(5)
    images = [rng.integers(0, 256, size, dtype=np.uint8).tobytes() for _ in range(count)]
    speeds: dict[str, list[float]] = {name: [] for name in WAYS}
    for _ in range(rounds):
        paths = {name: folder / f"{name}.mcap" for name in WAYS}
        ways = {name: way(paths[name]) for name, way in WAYS.items()}
        spent_s = dict.fromkeys(WAYS, 0.0)
        for number, image in enumerate(images):
            # Each way comes after each other one equally often: what the disk still does for one is felt by the next.
            order = list(ways)[number % len(ways) :] + list(ways)[: number % len(ways)]
            for name in order if number // len(ways) % 2 else order[::-1]:
                began = time.perf_counter()
                ways[name].take(number, image)
                spent_s[name] += time.perf_counter() - began
        for name, way in ways.items():
            way.close()
            paths[name].unlink()
            speeds[name].append(count * size / 1e6 / spent_s[name])
    ratios = {name: [own / plain for own, plain in zip(speeds[name], speeds["plain"], strict=True)] for name in WAYS if name != "plain"}
    return speeds, ratios


def main() -> None:
    """The comparison as a command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=60)
    parser.add_argument("--mb", type=float, default=1.0)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--folder", type=Path, help="on the tested disk; by default where temporary files are")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        speeds, ratios = measured(Path(name), arguments.images, int(arguments.mb * 1e6), arguments.rounds)
    for way, values in speeds.items():
        line = f"{way:<9} {statistics.median(values):7.1f} MB/s (median of {len(values)})"
        if way in ratios:
            some = sorted(ratios[way])
            line += f", {statistics.median(some):.2f} of plain ({some[0]:.2f} to {some[-1]:.2f}); asked {BAR}"
        sys.stdout.write(line + "\n")


if __name__ == "__main__":
    main()
