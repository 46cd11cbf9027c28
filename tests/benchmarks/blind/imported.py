"""Logs of maps that another engine made, of experiments with something hidden in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from blind.experiment import Conditions, hidden
from numexp.asfolder import HEADER, map_text
from numexp.world import HEIGHT_PX, WIDTH_PX
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, uniform_filter

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.grid import Grid
from semlive.service.replay.import_maps import ImportRequest, import_folder
from semlive_simulators.effects.interfaces import Effect


def imported(folder: Path, conditions: Conditions, effects: tuple[Effect, ...], grid: Grid) -> Path:
    """The log that `semlive import` makes of a new folder."""
    folder.mkdir()
    scan, lines = conditions.scan, [HEADER]
    for item in hidden(conditions, effects, grid):
        pose = item.pose
        numbers = (scan.dwell_time_s, scan.row_time_s, WIDTH_PX, HEIGHT_PX, 1, pose.load_n, *pose.commanded_px)
        reported = ",".join(repr(number) for number in numbers)
        lines += [f"{when.frame},{pose.pair},{pose.phase.value},{when.start_s!r},{reported}" for when in item.times]
        for dmap in (*item.maps, *_within(item.maps, grid)):
            (folder / f"disparity_{dmap.reference}_{dmap.current}.csv").write_text(map_text(dmap))
    (folder / "frames.csv").write_text("\n".join([*lines, ""]))
    log = folder.with_suffix(".mcap")
    import_folder(ImportRequest(folder, log, subset_px=43))
    return log


def _within(maps: tuple[DisparityMap, ...], grid: Grid) -> list[DisparityMap]:
    """From the first frame of a pair to the second, on the grid of the first: by what both show of frame 0; lost where one of them is."""
    if len(maps) < 2:
        return []
    first, second = maps
    item, two = _filled(first), _filled(second)
    there = np.indices(grid.shape) - item[::-1] / grid.step_px
    u, v = (map_coordinates(moved, there, order=3, mode="nearest") for moved in two - item)
    lost = map_coordinates(np.where(first.valid & second.valid, 0, 1), there, order=0, mode="nearest").astype(bool)
    status = np.where(lost, PoiStatus.LOW_ZNCC, PoiStatus.CONVERGED).astype(np.uint8)
    sigma = np.where(lost, 0.0, second.sigma_u_px.max())
    return [replace(second, reference=first.current, u_px=u, v_px=v, sigma_u_px=sigma, sigma_v_px=sigma, status=status)]


def _filled(dmap: DisparityMap) -> NDArray[np.float64]:
    """(2, ny, nx) px along x and y; a lost point is the mean of its neighbours."""
    near = uniform_filter(dmap.valid.astype(float), 3)
    both = [(item, uniform_filter(np.where(dmap.valid, item, 0.0), 3)) for item in (dmap.u_px, dmap.v_px)]
    return np.stack([np.where(dmap.valid, item, total / np.maximum(near, 1e-9)) for item, total in both])
