"""Logs with rendered images, their pairs and their maps, without a daemon and without waiting."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from semlive import dic
from semlive.data.clock import Clock
from semlive.data.disparity import DisparityMap
from semlive.data.experiment import Phase, Step
from semlive.data.frame import ExportedFile, Frame
from semlive.data.loading import FrameLoad
from semlive.data.pair import PairDecision
from semlive.data.settings import DicSettings
from semlive.formats import read_frame
from semlive.formats.log.maps import encode_map
from semlive.formats.log.messages import DIC_MAP, RunMessage
from semlive.formats.log.reader import LogMessage
from semlive.service.config.configuration import parse_config
from semlive.service.diagnosis.images import ImageChannels, ImageData
from semlive.service.log.files import messages
from semlive.service.log.pairs import LogNotes, log_settings, pairs_with_maps
from semlive.service.log.recording import Recorder
from semlive.service.log.run_log import RunLog
from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.microscope.column import Scan

S, PIXEL_UM = 10**9, 1.25
BEGIN_NS = 1_772_439_825 * S
CONFIG = {
    "sem": {"folder": "export", "pixel_size_um": PIXEL_UM},
    "stage": {"driver": "null"},
    "protocol": {"calibration_shifts_px": [[0, 0]]},
}


class _Now:
    """A clock that does not advance."""

    def now_ns(self) -> int:
        return BEGIN_NS

    def mono_ns(self) -> int:
        return BEGIN_NS

    def current(self) -> Clock:
        return Clock(BEGIN_NS, BEGIN_NS)


def moved(pair: int, shift_px: tuple[float, float]) -> Step:
    """A step of calibration."""
    return Step(pair, Phase.CALIBRATION, (shift_px[0] * PIXEL_UM, shift_px[1] * PIXEL_UM), shift_px, None)


def image_data(log: Path) -> ImageData:
    """The image channels of all pairs of a log."""
    channels = ImageChannels(log_settings(log).scan, 0)
    for decision, maps in pairs_with_maps(log, channels.noting(messages(log)), LogNotes()):
        channels.take(decision, maps)
    return channels.data()


def log_of(
    folder: Path,
    images: Iterable[np.ndarray],
    scan: Scan,
    start_s: Sequence[float],
    settings: DicSettings,
    steps: Sequence[Step] = (),
) -> Path:
    """A log with the images, their pairs and all maps of these.

    Args:
        folder: made.
        images: frames, two for each pair.
        scan: that they were made with.
        start_s: of each frame.
        settings: of the maps.
        steps: what was commanded for each pair, and its load; none is at rest.
    """
    folder.mkdir()
    recorder = Recorder(folder / "run.000.mcap", _Now(), lambda _: None)
    journal = RunLog(recorder)
    config = parse_config(CONFIG, "here")
    journal.write_message(RunMessage(run="run", started_time_ns=BEGIN_NS, host="here", versions={}, config=config.model_dump(mode="json")))
    export, frames = Export(WriteStyle.DIRECT, 0.0, 1.0, 1, 0, "x", Vendor.FEI), list[Frame]()
    grid = dic.grid_for(settings, scan.width_px, scan.height_px)

    def note(reference: int, current: int, end_ns: int) -> None:
        prepared = ready if reference == 0 else dic.prepare(frames[reference].image, grid, settings)
        found: DisparityMap = dic.correlate(prepared, frames[current].image, settings, reference_frame=reference, current_frame=current)
        journal.output(LogMessage(DIC_MAP, end_ns, end_ns, current, encode_map(found)))

    for number, image in enumerate(images):
        end_ns = BEGIN_NS + round((start_s[number] + scan.frame_time_s) * S)
        data = export.encode(image, ImageMetadata(scan, end_ns, 0, 0, number, "a.tif")).image
        file = ExportedFile(number, f"x_{number}.tif", data, hashlib.sha256(data).hexdigest(), end_ns, end_ns + S)
        journal.file(file)
        frames.append(read_frame(file, config.analysis_settings().scan))
        if number == 0:
            ready = dic.prepare(frames[0].image, grid, settings)
        if number % 2:
            pair = number // 2
            step = steps[pair] if steps else moved(pair, (0.0, 0.0))
            held = None if step.load_n is None else FrameLoad(step.load_n, step.load_n, step.load_n, 0.0)
            journal.pair(PairDecision(pair, step, frames[-2].info, frames[-1].info, held and (held, held)))
            note(number - 1, number, end_ns)
            if pair:
                note(0, number - 1, end_ns)
                note(0, number, end_ns)
    assert recorder.close()
    return folder
