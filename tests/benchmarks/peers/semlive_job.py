"""Correlate a folder's pair with the semlive of PYTHONPATH, once for each line of the standard input: folder, step, region.

Each line of the output holds the processor seconds and the number of valid points of one correlation with a new reference.
"""

import json
import sys
import time
from pathlib import Path

import tifffile

from semlive import dic

folder, step, region = Path(sys.argv[1]), int(sys.argv[2]), tuple(int(word) for word in sys.argv[3].split(","))
first, second = (tifffile.imread(folder / "images" / name) for name in ("0_ref.tif", "1_cur.tif"))
settings = dic.DicSettings(step_px=step, roi_px=region)
grid = dic.grid_for(settings, first.shape[1], first.shape[0])
dic.warm_up(settings)
dic.match(first, second, grid, settings)
for _ in sys.stdin:
    start = time.process_time()
    found = dic.match(first, second, grid, settings)
    seconds = time.process_time() - start
    sys.stdout.write(json.dumps({"cpu_s": seconds, "points": int(found.valid.sum())}) + "\n")
    sys.stdout.flush()
