"""Laws of settling of the dictionary agree with the simulators' own, at every pixel size and dwell time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from semlive.model.effects import SETTLING_CLASSES, TWO_TERM_CLASSES, RunGeometry
from semlive_simulators.effects.interfaces import PixelVisits
from semlive_simulators.effects.settling import (
    FlybackSettling,
    FrameStartSettling,
    FrameStartSettlingInPosition,
    RowStartSettlingInPosition,
)
from semlive_simulators.microscope.scan import Scan
from semlive_simulators.specimen.specimen import at_rest

FIRST = Scan(1024, 884, 1e-4, 884 * 0.107, 10.0, 1.25)
SCANS = {
    "the same": FIRST,
    "half the dwell": replace(FIRST, dwell_time_s=5e-5, frame_time_s=884 * 0.0535),
    "half the pixel size": replace(FIRST, pixel_size_um=0.625),
}
LAWS: dict[str, tuple[Any, dict[str, float]]] = {
    "flyback_settling": (FlybackSettling(0.8, 3e-3, -0.4, 2e-2), {"settling_s": 3e-3, "second_settling_s": 2e-2}),
    "row_start_settling_in_position": (
        RowStartSettlingInPosition(0.8 * 1.25, 50.0 * 1.25, -0.4 * 1.25, 210.0 * 1.25),
        {"length_px": 50.0, "second_length_px": 210.0},
    ),
    "frame_start_settling": (FrameStartSettling(0.8, 0.5, 4.0, -0.4, 0.3, 25.0), {"settling_s": 4.0, "second_settling_s": 25.0}),
    "frame_start_settling_in_position": (
        FrameStartSettlingInPosition(0.8 * 1.25, 0.5 * 1.25, 40.0 * 1.25, -0.4 * 1.25, 0.3 * 1.25, 260.0 * 1.25),
        {"length_px": 40.0, "second_length_px": 260.0},
    ),
}
AT = np.array([[56.0, 60.0], [300.0, 500.0], [960.5, 820.25]])


def geometry(scan: Scan) -> RunGeometry:
    """Three blocks of one frame."""
    nothing: Any = np.zeros((1, len(AT), 2))
    in_row_s, row_s = AT[None, :, 0] * scan.dwell_time_s, AT[None, :, 1] * scan.row_time_s
    none: Any = None
    return RunGeometry(
        address_px=AT[None] - scan.centre_px, disparity_px=nothing, composed=np.zeros(1, dtype=bool),
        time_s=in_row_s + row_s, time_in_frame_s=in_row_s + row_s,
        time_in_row_s=in_row_s, drift_rate_px_s=nothing, distortion_px=nothing, half_px=float(scan.centre_px[0]),
        half_height_px=float(scan.centre_px[1]), frame=np.zeros(1, dtype=np.int64), pair=np.zeros(1, dtype=np.int64), start_s=np.zeros(1),
        steps=none, drift_knot_s=1.0, distortion_knot_px=1.0, pixel_ratio=scan.pixel_size_um / FIRST.pixel_size_um,
    )  # fmt: skip


def simulated_px(effect: Any, scan: Scan) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(3, 2) px of the simulator's effect at the blocks."""
    motion = at_rest((0.0, 0.0), np.zeros((2, 2)))
    visits = PixelVisits(AT[:, :1], AT[:, 1:], np.zeros((3, 1)), 0.0, 0, 0, np.zeros((3, 1), bool), scan, motion, (AT[:, :1], AT[:, 1:]))
    u, v = effect.offset_px(visits)
    return np.concatenate(np.broadcast_arrays(u, v, AT[:, :1])[:2], axis=1)


@pytest.mark.parametrize("change", SCANS)
@pytest.mark.parametrize("single", SETTLING_CLASSES, ids=lambda family: family.name)
def test_two_exponentials_are_those_of_the_simulator(single: Any, change: str) -> None:
    effect, values = LAWS[single.name]
    scan = SCANS[change]
    field = TWO_TERM_CLASSES[single.name].basis_field(geometry(scan), values)
    amplitudes = [0.8, -0.4] if field.field_px.shape[-1] == 2 else [0.8, 0.5, -0.4, 0.3]
    on_specimen = scan.pixel_size_um / FIRST.pixel_size_um if "position" in single.name else 1.0
    assert field.field_px[0] @ amplitudes / on_specimen == pytest.approx(simulated_px(effect, scan), abs=1e-12)
    assert len(field.reported_parameters) == len(amplitudes)


@pytest.mark.parametrize("single", SETTLING_CLASSES, ids=lambda family: family.name)
def test_one_exponential_is_the_first_of_two(single: Any) -> None:
    _, values = LAWS[single.name]
    one, two = single.basis_field(geometry(FIRST), values), TWO_TERM_CLASSES[single.name].basis_field(geometry(FIRST), values)
    count = one.field_px.shape[-1]
    assert two.field_px.shape[-1] == 2 * count
    np.testing.assert_array_equal(two.field_px[..., :count], one.field_px)


def test_constants_of_two_terms_differ() -> None:
    for family in TWO_TERM_CLASSES.values():
        first, second = (parameter.name for parameter in family.nonlinear_parameters)
        values = list(family.grid(geometry(FIRST)))
        assert len(values) >= 3
        assert all(value[second] > 2.5 * value[first] for value in values)
