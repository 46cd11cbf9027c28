"""Logs of maps that another engine made, of experiments with something hidden in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from blind.experiment import Conditions, hidden
from numexp.asfolder import HEADER, map_text
from numexp.world import HEIGHT_PX, WIDTH_PX
from scipy.ndimage import map_coordinates

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.service.importing import Import, import_folder
from semlive_simulators.effects.protocol import Effect


def imported(folder: Path, conditions: Conditions, effects: tuple[Effect, ...], grid: Grid) -> Path:
    """The log that `semlive import` makes of a new folder."""
    folder.mkdir()
    scan, lines = conditions.scan, [HEADER]
    for one in hidden(conditions, effects, grid):
        pose = one.pose
        numbers = (scan.dwell_time_s, scan.row_time_s, WIDTH_PX, HEIGHT_PX, 1, pose.load_n, *pose.commanded_px)
        told = ",".join(repr(number) for number in numbers)
        lines += [f"{when.frame},{pose.pair},{pose.phase.value},{when.start_s!r},{told}" for when in one.times]
        for dmap in (*one.maps, *_within(one.maps, grid)):
            (folder / f"disparity_{dmap.reference}_{dmap.current}.csv").write_text(map_text(dmap))
    (folder / "frames.csv").write_text("\n".join([*lines, ""]))
    log = folder.with_suffix(".mcap")
    import_folder(Import(folder, log, subset_px=43))
    return log


def _within(maps: tuple[DisparityMap, ...], grid: Grid) -> list[DisparityMap]:
    """From the first frame of a pair to the second, on the grid of the first: by what both show of frame 0."""
    if len(maps) < 2:
        return []
    first, second = maps
    there = [at - moved / grid.step_px for at, moved in zip(np.indices(grid.shape), (first.v_px, first.u_px), strict=True)]
    moved = [
        map_coordinates(two - one, there, order=3, mode="nearest") for one, two in ((first.u_px, second.u_px), (first.v_px, second.v_px))
    ]
    return [replace(second, reference=first.current, u_px=moved[0], v_px=moved[1])]
