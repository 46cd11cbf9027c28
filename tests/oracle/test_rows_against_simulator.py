"""Row registration against the simulated microscope: its own effects, its own speckle and noise."""

import dataclasses

import numpy as np

from semlive import dic
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.scan_deflection import MainsHum, RowJitter
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import load_scenario

WIDTH, HEIGHT = 320, 240
HUM_HZ = 50.0


def pair(*effects):
    paper = load_scenario("paper_x200")
    scan = dataclasses.replace(paper.scan, width_px=WIDTH, height_px=HEIGHT, frame_time_s=HEIGHT * paper.scan.row_time_s)
    scenario = dataclasses.replace(paper, scan=scan, effects=EffectSet(effects))
    column = scenario.column()
    starts_s = (0.0, np.ceil(scan.frame_time_s) + 0.5 / HUM_HZ)  # hum of opposite phase, which the pair shows doubled
    return scan, [render_frame(scenario, start_s, frame=frame, column=column) for frame, start_s in enumerate(starts_s)]


def registered(first, second):
    settings = dic.DicSettings(step_px=10, roi_px=None)
    return dic.register_rows(first, second, dic.match(first, second, settings=settings), segments=4)


def test_jitter_of_the_simulated_scan_is_found_as_such():
    _, (first, second) = pair(RowJitter(0.05))
    jitter = dic.row_jitter(registered(first, second))
    # 196 rows of two frames know a standard deviation to 4 %, and the noise's own share adds to it.
    assert abs(jitter.sd_u_px - 0.05) < 0.006 + 3.0 * jitter.sigma_u_px
    assert jitter.sigma_u_px < 0.006
    assert jitter.sd_v_px < 0.5 * jitter.sd_u_px


def test_hum_of_the_simulated_scan_is_found_at_its_frequency():
    scan, (first, second) = pair(MainsHum(0.05, 0.0, HUM_HZ, 0.4))
    shifts = registered(first, second)
    power = np.abs(np.fft.rfft(shifts.u_px - shifts.u_px.mean()))
    cycles_per_row = (HUM_HZ * scan.row_time_s) % 1.0
    expected = min(cycles_per_row, 1.0 - cycles_per_row) * shifts.row_px.size
    assert abs(int(np.argmax(power[5:])) + 5 - expected) <= 1.5
