"""`semlive experiment decide`: one JSON object, and the messages for runs that decide nothing."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from blind.experiment import Conditions
from blind.imported import imported
from blind.observing import QUICK
from numexp.stated_estimate import state_estimate
from numexp.world import SCAN

from semlive.data.grid import Grid
from semlive.diagnose.experiments.protocols import square_px
from semlive_simulators.effects.image_field import AnisotropicPixel
from semlive_simulators.effects.settling import FlybackSettling
from semlive_simulators.microscope.scan import Scan

Printed = tuple[int, str, str]
GRID = Grid(56, 56, 20, 45, 38, 43)
HALF = replace(SCAN, dwell_time_s=0.5 * SCAN.dwell_time_s, frame_time_s=0.5 * SCAN.frame_time_s)
SETTLES = FlybackSettling(1.0, 4e-3)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A calibration and another with half the dwell, in both of which rows begin before the beam has come to rest."""
    base = tmp_path_factory.mktemp("scans")
    return written(base / "one", 71, SCAN, None), written(base / "other", 72, HALF, 71)


def written(folder: Path, seed: int, scan: Scan, bent_like: int | None) -> Path:
    conditions = Conditions(
        seed, calibration=7, tension=0, missing=0.0, outliers=0.0, scan=scan, bent_like=bent_like, subset_px=GRID.subset_px
    )
    return state_estimate(imported(folder, conditions, (SETTLES,), GRID), QUICK)


def test_a_decision_is_one_object(semlive: Callable[..., Printed], runs: tuple[Path, Path]) -> None:
    code, out, _ = semlive("experiment", "decide", *map(str, runs), "--json")
    found = json.loads(out)
    assert code == 0
    assert (found["outcome"], found["effect"]["name"], found["ambiguous"]) == ("IDENTIFIED", "flyback_settling", [])
    reported = found["effect"]["parameters"]
    assert reported["amplitude_px"]["unit"] == "px"
    assert abs(reported["amplitude_px"]["value"] - 1.0) < 3.0 * reported["amplitude_px"]["sigma"]
    assert max(found["evidence"], key=found["evidence"].get) == "flyback_settling"
    assert (found["effects"], found["turned"]) == ([found["effect"]], None)

    code, out, _ = semlive("experiment", "decide", *map(str, runs))
    assert code == 0
    assert out.startswith("IDENTIFIED: ")
    assert "settling_s" in out


def test_a_run_next_to_itself_decides_nothing(semlive: Callable[..., Printed], runs: tuple[Path, Path]) -> None:
    code, out, err = semlive("experiment", "decide", str(runs[0]), str(runs[0]), "--json")
    assert (code, out) == (1, "")
    assert "half or twice the dwell" in err.splitlines()[-1]


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A calibration and another with the scan turned, of pixels that are not square."""
    base = tmp_path_factory.mktemp("turned")
    moves = tuple((x, y) for x, y in square_px(60.0))
    first = Conditions(73, len(moves), 0, missing=0.0, outliers=0.0, moves_px=moves, stage_error_px=0.1, of_column=True)
    other = replace(first, seed=74, scan=replace(SCAN, rotation_rad=0.5 * math.pi), bent_like=73)
    item, two = (
        state_estimate(imported(base / name, each, (AnisotropicPixel(0.02),), Grid(110, 110, 50, 17, 14, 43)), QUICK)
        for name, each in (("one", first), ("other", other))
    )  # fmt: skip
    return item, two


def test_a_turned_scan_reports_all_that_has_a_name(semlive: Callable[..., Printed], turned: tuple[Path, Path]) -> None:
    code, out, _ = semlive("experiment", "decide", *map(str, turned), "--json")
    found = json.loads(out)
    assert code == 0
    assert (found["outcome"], [item["name"] for item in found["effects"]]) == ("IDENTIFIED", ["anisotropic_pixel"])
    assert found["effect"] == found["effects"][0]
    reported = found["turned"]["parameters"]
    assert abs(reported["x_excess"]["value"] - 0.02) < 3.0 * reported["x_excess"]["sigma"]
    assert abs(reported["turn_rad"]["value"] - 0.5 * math.pi) < 0.01
    assert found["turned"]["distortion_of"] == "column"

    code, out, _ = semlive("experiment", "decide", *map(str, turned))
    assert code == 0
    assert out.startswith("IDENTIFIED: this effect rotates with the scan\nanisotropic_pixel, at most 1")
    assert "the distortion is fixed to the column" in out
