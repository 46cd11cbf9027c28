"""Files that grow in experiment time: one thread writes images, another the sidecars, so that no image waits for a sidecar."""

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
from semlive_simulators.specimen.machine import Window
from semlive_simulators.specimen.sensors import Reading

_JOIN_S = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class FinishedScan:
    """A frame whose scan is complete.

    Attributes:
        frame: number of the scan, from 0.
        start_time_ns: start of the scan, UTC ns.
        end_time_ns: end of the scan, UTC ns.
        image: (height, width) of the detector's dtype.
        reading: readings of the devices at the end.
        window: true motion during the scan.
    """

    frame: int
    start_time_ns: int
    end_time_ns: int
    image: NDArray[np.unsignedinteger]
    reading: Reading
    window: Window


@dataclass(frozen=True, slots=True, eq=False)
class Exported(FinishedScan):
    """A frame whose files are complete.

    Attributes:
        file: name of the image file in the export folder.
    """

    file: str


class ExportThread:
    """Writes frames in their order, in chunks and with the delays of an instrument.

    Images are written one after the other. A frame that ends while the previous one is being written waits, as in real software, and its
    delays count from the end of that export. Sidecars are written at the same time by another thread. `exported` is called, in order,
    when all files of a frame are complete. After a stop the remaining files are written without delays, and none stays incomplete.
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
        self._sidecars: queue.SimpleQueue[tuple[Exported | None, int, tuple[FilePlan, ...]] | None] = queue.SimpleQueue()
        self._threads = [
            threading.Thread(target=self._guarded, args=(work,), name=name, daemon=True)
            for name, work in (("export", self._write_images), ("sidecar", self._write_sidecars))
        ]

    @property
    def exported(self) -> int:
        """Frames completely written so far."""
        return self._exported

    def start(self) -> None:
        """Start both threads."""
        for thread in self._threads:
            thread.start()

    def put(self, scanned: FinishedScan) -> None:
        """Add a frame to be written."""
        self._images.put(scanned)

    def stop(self) -> None:
        """Write the remaining frames, without delays if the stop is set, and end both threads."""
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
                self._sidecars.put(self._write_image(item))
        finally:
            self._sidecars.put(None)

    def _write_image(self, item: FinishedScan) -> tuple[Exported | None, int, tuple[FilePlan, ...]]:
        """Write the image of a frame.

        Returns:
            The exported frame, None if its image is never finished; the instant from which its plans count, ns; the plans of its sidecars.
        """
        scenario, reading = self._scenario, item.reading
        begin_ns = max(item.end_time_ns, self._free_ns)
        name = scenario.export.free_name(item.frame, lambda file: (self._folder / file).exists())
        stamp_ns = scenario.stamp_ns(item.end_time_ns, self._clock.start_ns)
        facts = ImageMetadata(
            scenario.scan,
            stamp_ns,
            reading.stage.x_um,
            reading.stage.y_um,
            item.frame,
            name,
            reading.beam.x_um,
            reading.beam.y_um,
            scenario.row_start_s,
        )
        image, *sidecars = plan_files(scenario.export.encode(item.image, facts), name, scenario.export, item.frame)
        write_file(image, self._folder, begin_ns, lambda since_s: self._at("export", begin_ns + round(since_s * 1e9)))
        self._free_ns = begin_ns + round(image.last_s * 1e9)
        exported = Exported(item.frame, item.start_time_ns, item.end_time_ns, item.image, reading, item.window, name)
        return exported if image.finished else None, begin_ns, tuple(sidecars)

    def _write_sidecars(self) -> None:
        while (work := self._sidecars.get()) is not None:
            item, begin_ns, plans = work
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
