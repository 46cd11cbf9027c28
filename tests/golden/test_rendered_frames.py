"""The pixels of the scenarios that come along are fixed: a deliberate change of one of them is stated here."""

from __future__ import annotations

import dataclasses
import hashlib

import numpy as np
import pytest

from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen.specimen import Motion, at_rest

PULLED = Motion(
    np.array([300.0, 400.0]), np.array([[3.0, -2.0], [3.4, -2.9]]), np.array([np.zeros((2, 2)), [[-1e-3, -1e-4], [1e-4, 3e-3]]])
)


@pytest.mark.parametrize(
    ("name", "digest"),
    [
        ("paper_x200", "812ad841cf23949c36a13de47583ecc23c05a4613c462a8870ebd5b00a9cf3d5"),
        ("paper_x10000", "1d7cad9103ad1247f43c4c4fa054d58e3f17b34639a628cc2ce9b4c94ed690f1"),
        ("short", "b7f97cb6759094e0ad0a8d5c39ceb0b1a70a8a6b3be6a7c693d3a74e91cc5db8"),
    ],
)
def test_a_complete_frame_has_its_recorded_pixels(name: str, digest: str) -> None:
    image = render_frame(load_scenario(name), 302.5, PULLED, frame=3)
    assert (image.shape, image.dtype) == ((884, 1024), np.uint8)
    assert hashlib.sha256(image.tobytes()).hexdigest() == digest


@pytest.mark.parametrize(
    ("name", "digest"),
    [
        ("paper_x200", "374babad43f31a8a76edfe1f07df7f3b8e71f3c8e9eb51a3689c312beebc5164"),
        ("paper_x10000", "2f37352136d9c16a1be67cb1a2a2fdbdf257d1d2f93bacb0fe8b63384e14f873"),
        ("short", "f8316113aba758effe1868fc6c8cf1bf2c638cb1a5021a38b1f8b17bb74380eb"),
    ],
)
def test_a_small_frame_has_the_same_pixels_as_ever(name: str, digest: str) -> None:
    scenario = load_scenario(name)
    scan = dataclasses.replace(scenario.scan, width_px=96, height_px=64, frame_time_s=64 * scenario.scan.row_time_s)
    image = render_frame(dataclasses.replace(scenario, scan=scan), 7.0, at_rest((4.3, -2.1)), frame=1)
    assert hashlib.sha256(image.tobytes()).hexdigest() == digest
