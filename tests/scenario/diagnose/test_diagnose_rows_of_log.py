"""Rows of a log's images: hum of the simulated microscope, from bytes in the log to its name."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from imaged_log import image_data, log_of

from semlive.data.settings import DicSettings
from semlive.diagnose.rows.verdict import diagnose_rows
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.scan_deflection import MainsHum
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import load_scenario

PAPER = load_scenario("paper_x200")
SCAN = dataclasses.replace(PAPER.scan, width_px=320, height_px=240, frame_time_s=240 * PAPER.scan.row_time_s)
SETTINGS = DicSettings(step_px=10, roi_px=None)


def test_hum_in_the_images_of_a_log_is_named(tmp_path: Path) -> None:
    detector = dataclasses.replace(PAPER.detector, read_noise=2.0, shot_noise=0.2)
    scenario = dataclasses.replace(PAPER, scan=SCAN, detector=detector, effects=EffectSet((MainsHum(0.1, 0.05, 50.0, 0.4),)))
    column = scenario.column()
    # 26 s and a quarter, three quarters and half a period of the mains between frames.
    starts_s = (0.0, 26.005, 52.02, 78.03)
    images = [render_frame(scenario, start_s, frame=at, column=column) for at, start_s in enumerate(starts_s)]
    log = log_of(tmp_path / "run", images, SCAN, starts_s, SETTINGS)

    observed = image_data(log)
    found = diagnose_rows(observed.rows)

    assert (len(observed.rows), observed.no_rows) == (2, "")
    (effect,) = [item for item in found.effects if item.name == "mains_hum"]
    reported = {item.name: item.value for item in effect.parameters}
    assert abs(reported["frequency_hz"] - 50.0) < 0.01
    assert 0.05 < reported["amplitude_x_px"] < 0.2
