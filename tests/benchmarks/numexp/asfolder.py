"""An experiment as another engine would hand it over: a folder for ``semlive import``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numexp.experiment import Experiment, Taken
from numexp.world import HEIGHT_PX, WIDTH_PX

from semlive.data.disparity import DisparityMap
from semlive.data.experiment import Phase

HEADER = "frame,pair,phase,start_s,dwell_s,row_time_s,width,height,integrations,load_n,shift_x_px,shift_y_px"
MODULUS_MPA = 71.1e3


def write_folder(experiment: Experiment, folder: Path, *, area_mm2: float = 1.0, seconds: bool = False, decimals: int = 9) -> Path:
    """Write `frames.csv` and the maps.

    Args:
        experiment: what was imaged.
        folder: where to; it is made.
        area_mm2: of the specimen, for the loads.
        seconds: also write the maps from frame 0 to the second frame of each pair.
        decimals: of the disparities.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lines = [HEADER, *(line for taken in experiment.pairs for line in frame_lines(taken, taken.pair, 0.0, area_mm2))]
    (folder / "frames.csv").write_text("\n".join([*lines, ""]))
    for taken in experiment.pairs:
        for one in taken.maps:
            if one.reference or one.current % 2 == 0 or one.current == 1 or seconds:
                (folder / f"disparity_{one.reference}_{one.current}.csv").write_text(map_text(one, decimals))
    return folder


def frame_lines(taken: Taken, pair: int, later_s: float, area_mm2: float) -> list[str]:
    """The two lines of a pair that shows what one of the experiment's does."""
    load = ""
    if taken.phase is Phase.TENSION:
        load = repr(float(taken.observed[-1].gradient[1, 1]) * MODULUS_MPA * area_mm2)
    timing = taken.times[0].timing
    scan = f"{timing.dwell_time_s.value!r},{timing.row_time_s.value!r},{WIDTH_PX},{HEIGHT_PX},1"
    return [
        f"{2 * pair + member},{pair},{taken.phase.value},{taken.times[member].start_s + later_s!r},{scan},{load},," for member in (0, 1)
    ]


def map_text(one: DisparityMap, decimals: int = 9) -> str:
    """The map as CSV, without uncertainties, points that were lost marked as such."""
    x, y = one.grid.mesh()
    rows = np.column_stack([part.ravel() for part in (x, y, one.u_px, one.v_px, one.valid)]).tolist()
    reported = (f"{x:.0f},{y:.0f},{u:.{decimals}f},{v:.{decimals}f},{valid:.0f}" for x, y, u, v, valid in rows)
    return "\n".join(["x,y,u,v,valid", *reported, ""])
