"""Files that grow while time passes: one thread writes images, another what comes later, so that no frame waits for a sidecar."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from semlive_simulators.bench_clock import BenchClock
from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.writing import FilePlan, plan_files, write_file
from semlive_simulators.scenario import Scenario
from semlive_simulators.specimen.machine import Reading, Window

_JOIN_S = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class FinishedScan:
    """A frame whose scan is over.

    Attributes:
        frame: number of the scan, from 0.
        start_time_ns: when it began, UTC ns.
        end_time_ns: when it ended.
        image: (height, width) of the detector's dtype.
        reading: what the devices said at the end.
        window: what truly happened meanwhile.
    """

    frame: int
    start_time_ns: int
    end_time_ns: int
    image: NDArray[np.unsignedinteger]
    reading: Reading
    window: Window


@dataclass(frozen=True, slots=True, eq=False)
class Exported(FinishedScan):
    """A frame whose files are all there.

    Attributes:
        file: name of the image file in the export folder.
    """

    file: str


class ExportThread:
    """Writes frames in the order in which they come, bit by bit, as slowly as an instrument does.

    Images go to the share one after the other; a frame that ends while the one before is still being written waits, as in real
    software, and its times count from there. Sidecars are written beside that. `exported` is called, in order, when all files of
    a frame are there. A stop makes it hurry; nothing is left half-written.
    """

    def __init__(
        self,
        scenario: Scenario,
        clock: BenchClock,
        folder: Path,
        stop: threading.Event,
        exported: Callable[[Exported], None],
        failed: Callable[[BaseException], None],
    ) -> None:
        self._scenario = scenario
        self._clock = clock
        self._folder = folder
        self._stop = stop
        self._on_exported = exported
        self._failed = failed
        self._exported = 0
        self._free_ns = 0
        self._images: queue.SimpleQueue[FinishedScan | None] = queue.SimpleQueue()
        self._later: queue.SimpleQueue[tuple[Exported | None, int, tuple[FilePlan, ...]] | None] = queue.SimpleQueue()
        self._threads = [
            threading.Thread(target=self._guarded, args=(work,), name=name, daemon=True)
            for name, work in (("export", self._write_images), ("sidecar", self._write_later))
        ]

    @property
    def exported(self) -> int:
        """Frames completely written so far."""
        return self._exported

    def start(self) -> None:
        """Begin."""
        for thread in self._threads:
            thread.start()

    def put(self, scanned: FinishedScan) -> None:
        """Hand over a frame."""
        self._images.put(scanned)

    def stop(self) -> None:
        """Finish what was handed over, without the pauses once the stop is set, and end."""
        self._images.put(None)
        for thread in self._threads:
            if thread.is_alive():
                thread.join(timeout=_JOIN_S)

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:
            self._failed(error)
            raise

    def _write_images(self) -> None:
        try:
            while (item := self._images.get()) is not None:
                self._later.put(self._write_image(item))
        finally:
            self._later.put(None)

    def _write_image(self, item: FinishedScan) -> tuple[Exported | None, int, tuple[FilePlan, ...]]:
        """Write the image; gives it unless it is never finished, the instant from which its plans count, and the plans that are left."""
        scenario, reading = self._scenario, item.reading
        begin_ns = max(item.end_time_ns, self._free_ns)
        name = scenario.export.free_name(item.frame, lambda other: (self._folder / other).exists())
        told_ns = scenario.told_ns(item.end_time_ns, self._clock.start_ns)
        facts = ImageMetadata(
            scenario.scan, told_ns, reading.encoder_x_um, reading.encoder_y_um, item.frame, name, reading.beam_x_um, reading.beam_y_um
        )
        image, *later = plan_files(scenario.export.encode(item.image, facts), name, scenario.export, item.frame)
        write_file(image, self._folder, begin_ns, lambda since_s: self._at("export", begin_ns + round(since_s * 1e9)))
        self._free_ns = begin_ns + round(image.last_s * 1e9)
        exported = Exported(item.frame, item.start_time_ns, item.end_time_ns, item.image, reading, item.window, name)
        return exported if image.finished else None, begin_ns, tuple(later)

    def _write_later(self) -> None:
        while (handed := self._later.get()) is not None:
            item, begin_ns, plans = handed
            for plan in plans:
                self._write_sidecar(plan, begin_ns)
            if item is not None:
                self._exported += 1
                self._on_exported(item)

    def _write_sidecar(self, plan: FilePlan, begin_ns: int) -> None:
        write_file(plan, self._folder, begin_ns, lambda since_s: self._at("sidecar", begin_ns + round(since_s * 1e9)))

    @contextlib.contextmanager
    def _at(self, work: str, due_ns: int) -> Iterator[None]:
        self._clock.register_work(work, due_ns)
        self._clock.wait_until(due_ns, self._stop)
        yield
        self._clock.done(work)
