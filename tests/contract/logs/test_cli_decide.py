"""`semlive experiment decide`: one JSON object, and what is said of runs that decide nothing."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from blind.experiment import Conditions
from blind.imported import imported
from numexp.world import SCAN

from semlive.data.grid import Grid
from semlive_simulators.effects.flyback_settling import FlybackSettling
from semlive_simulators.scan import Scan

Said = tuple[int, str, str]
GRID = Grid(56, 56, 20, 45, 38, 43)
HALF = replace(SCAN, dwell_time_s=0.5 * SCAN.dwell_time_s, frame_time_s=0.5 * SCAN.frame_time_s)
SETTLES = FlybackSettling(1.0, 4e-3)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A calibration and another with half the dwell, in both of which rows begin before the beam has come to rest."""
    base = tmp_path_factory.mktemp("scans")
    return written(base / "one", 71, SCAN, None), written(base / "other", 72, HALF, 71)


def written(folder: Path, seed: int, scan: Scan, bent_like: int | None) -> Path:
    conditions = Conditions(seed, calibration=7, tension=0, missing=0.0, outliers=0.0, scan=scan, bent_like=bent_like)
    return imported(folder, conditions, (SETTLES,), GRID)


def test_a_decision_is_one_object(semlive: Callable[..., Said], runs: tuple[Path, Path]) -> None:
    code, out, _ = semlive("experiment", "decide", *map(str, runs), "--json")
    found = json.loads(out)
    assert code == 0
    assert (found["outcome"], found["effect"]["name"], found["ambiguous"]) == ("IDENTIFIED", "flyback_settling", [])
    told = found["effect"]["parameters"]
    assert told["amplitude_px"]["unit"] == "px"
    assert abs(told["amplitude_px"]["value"] - 1.0) < 3.0 * told["amplitude_px"]["sigma"]
    assert max(found["evidence"], key=found["evidence"].get) == "flyback_settling"

    code, out, _ = semlive("experiment", "decide", *map(str, runs))
    assert code == 0
    assert out.startswith("IDENTIFIED: ")
    assert "settling_s" in out


def test_a_run_beside_itself_decides_nothing(semlive: Callable[..., Said], runs: tuple[Path, Path]) -> None:
    code, out, err = semlive("experiment", "decide", str(runs[0]), str(runs[0]), "--json")
    assert (code, out) == (1, "")
    assert "half or twice the dwell" in err.splitlines()[-1]
