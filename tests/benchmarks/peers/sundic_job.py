"""Correlate a folder's pair with SUN-DIC, in SUN-DIC's environment, one process: folder, step."""

import json
import os
import sys
import time
from pathlib import Path

import numpy as np
from sundic import settings as sundic_settings
from sundic import sundic

folder, step = Path(sys.argv[1]), int(sys.argv[2])
os.chdir(folder)
settings = sundic_settings.Settings()
settings.DebugLevel = 0
settings.ImageFolder = "images"
settings.CPUCount = 1
settings.SubsetSize, settings.StepSize = 43, step
settings.BackgroundCutoff = 0


def run(roi):
    """(points, wall, processor seconds)."""
    settings.ROI = roi
    wall, cpu = time.perf_counter(), time.process_time()
    points = sundic.planarDICLocal(settings, "results.sdic")[0]
    return points, time.perf_counter() - wall, time.process_time() - cpu


run([101, 101, 60, 60])  # its kernels are compiled by then
points, wall, cpu = run([101, 101, 746, 596])
columns = (sundic.CompID.XCoordID, sundic.CompID.YCoordID, sundic.CompID.XDispID, sundic.CompID.YDispID)
np.save(folder / "points.npy", np.stack([points[:, :, k].ravel() for k in columns]))
sys.stdout.write("\n" + json.dumps({"wall_s": wall, "cpu_s": cpu}) + "\n")
