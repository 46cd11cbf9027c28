"""Rows of a log's images: hum of the simulated microscope, from bytes in the log to its name."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path

import numpy as np

from semlive import dic
from semlive.data.clock import Clock
from semlive.data.experiment import Phase, Step
from semlive.data.frame import ExportedFile, Frame
from semlive.data.pair import PairDecision
from semlive.data.settings import DicSettings
from semlive.diagnose.row_channel import diagnose_rows
from semlive.formats import read_frame
from semlive.formats.log import LogMessage
from semlive.formats.maps import encode_map
from semlive.formats.messages import DIC_MAP, RunMessage
from semlive.service.config import parse_config
from semlive.service.journal import Journal
from semlive.service.record import Recorder
from semlive.service.row_channel import rows_of_log
from semlive_simulators.effects.composition import Effects
from semlive_simulators.effects.mains_hum import MainsHum
from semlive_simulators.exporters.facts import ImageFacts
from semlive_simulators.exporters.settings import Export, Style, Vendor
from semlive_simulators.render import render_frame
from semlive_simulators.scenario import load_scenario

S = 10**9
BEGIN_NS = 1_772_439_825 * S
PAPER = load_scenario("paper_x200")
SCAN = dataclasses.replace(PAPER.scan, width_px=320, height_px=240, frame_time_s=240 * PAPER.scan.row_time_s)
CONFIG = {
    "sem": {"folder": "export", "pixel_size_um": 1.25},
    "stage": {"driver": "null"},
    "protocol": {"calibration_shifts_px": [[0, 0]]},
}
SETTINGS = DicSettings(step_px=10, roi_px=None)


class _Now:
    """A clock that stands."""

    def now_ns(self) -> int:
        return BEGIN_NS

    def mono_ns(self) -> int:
        return BEGIN_NS

    def current(self) -> Clock:
        return Clock(BEGIN_NS, BEGIN_NS)


def log_of(folder: Path, images: list[np.ndarray]) -> Path:
    """A log with the images, their pairs and the maps within these."""
    folder.mkdir()
    recorder = Recorder(folder / "run.000.mcap", _Now(), lambda _: None)
    journal = Journal(recorder)
    config = parse_config(CONFIG, "here")
    journal.note(RunMessage(run="run", started_time_ns=BEGIN_NS, host="here", versions={}, config=config.model_dump(mode="json")))
    export, frames = Export(Style.DIRECT, 0.0, 1.0, 1, 0, "x", Vendor.FEI), list[Frame]()
    for number, image in enumerate(images):
        end_ns = BEGIN_NS + (number + 1) * 30 * S
        data = export.encode(image, ImageFacts(SCAN, end_ns, 0, 0, number, "a.tif")).image
        file = ExportedFile(number, f"x_{number}.tif", data, hashlib.sha256(data).hexdigest(), end_ns, end_ns + S)
        journal.file(file)
        frames.append(read_frame(file, config.analysis_settings().scan))
        if number % 2:
            pair, (first, second) = number // 2, frames[-2:]
            step = Step(pair, Phase.CALIBRATION, (0.0, 0.0), (0.0, 0.0), None)
            journal.pair(PairDecision(pair, step, first.info, second.info, None))
            ready = dic.prepare(first.image, dic.grid_for(SETTINGS, SCAN.width_px, SCAN.height_px), SETTINGS)
            within = dic.correlate(ready, second.image, SETTINGS, reference_frame=number - 1, current_frame=number)
            journal.output(LogMessage(DIC_MAP, end_ns, end_ns, number, encode_map(within)))
    assert recorder.close()
    return folder


def test_hum_in_the_images_of_a_log_is_named(tmp_path: Path) -> None:
    detector = dataclasses.replace(PAPER.detector, read_noise=2.0, shot_noise=0.2)
    scenario = dataclasses.replace(PAPER, scan=SCAN, detector=detector, effects=Effects((MainsHum(0.1, 0.05, 50.0, 0.4),)))
    column = scenario.column()
    # 26 s and a quarter, three quarters and half a period of the mains between frames.
    images = [render_frame(scenario, start_s, frame=at, column=column) for at, start_s in enumerate((0.0, 26.005, 52.02, 78.03))]
    log = log_of(tmp_path / "run", images)

    series, why_not = rows_of_log(log)
    found = diagnose_rows(series)

    assert (len(series), why_not) == (2, "")
    (effect,) = [one for one in found.effects if one.name == "mains_hum"]
    told = {one.name: one.value for one in effect.parameters}
    assert abs(told["frequency_hz"] - 50.0) < 0.01
    assert 0.05 < told["amplitude_x_px"] < 0.2
