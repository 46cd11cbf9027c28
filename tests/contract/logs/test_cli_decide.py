"""`semlive experiment decide`: one JSON object, and what is said of runs that decide nothing."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from blind.experiment import Conditions, hidden
from numexp.asfolder import HEADER, map_text
from numexp.world import HEIGHT_PX, SCAN, WIDTH_PX
from scipy.ndimage import map_coordinates

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.service.importing import Import, import_folder
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
    """A log of maps that another engine made."""
    conditions = Conditions(seed, calibration=7, tension=0, missing=0.0, outliers=0.0, scan=scan, bent_like=bent_like)
    folder.mkdir()
    lines = [HEADER]
    for one in hidden(conditions, (SETTLES,), GRID):
        pair = one.pose.pair
        times = f"{scan.dwell_time_s!r},{scan.row_time_s!r},{WIDTH_PX},{HEIGHT_PX},1"
        lines += [f"{when.frame},{pair},calibration,{when.start_s!r},{times},,," for when in one.times]
        for dmap in (*one.maps, *within(one.maps)):
            (folder / f"disparity_{dmap.reference}_{dmap.current}.csv").write_text(map_text(dmap))
    (folder / "frames.csv").write_text("\n".join([*lines, ""]))
    log = folder.with_suffix(".mcap")
    import_folder(Import(folder, log, subset_px=43))
    return log


def within(maps: tuple[DisparityMap, ...]) -> list[DisparityMap]:
    """From the first frame of a pair to the second, on the grid of the first: by what both show of frame 0."""
    if len(maps) < 2:
        return []
    first, second = maps
    there = [at - moved / GRID.step_px for at, moved in zip(np.indices(GRID.shape), (first.v_px, first.u_px), strict=True)]
    moved = [
        map_coordinates(two - one, there, order=3, mode="nearest") for one, two in ((first.u_px, second.u_px), (first.v_px, second.v_px))
    ]
    return [replace(second, reference=first.current, u_px=moved[0], v_px=moved[1])]


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
