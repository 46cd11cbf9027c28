"""Correlate a folder's pair with pyvale, in pyvale's environment: folder, step, scan method, edge of the blurring kernel."""

import json
import sys
import time
from pathlib import Path

import numpy as np
from pyvale import dic

folder, step, method, blur = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3], int(sys.argv[4])
mask = np.zeros((884, 1024), dtype=bool)
mask[101 - 21 : 697 + 21, 101 - 21 : 847 + 21] = True  # complete subsets have to lie inside
out = folder / "pyvale"
out.mkdir(exist_ok=True)
for old in out.iterdir():
    old.unlink()
wall, cpu = time.perf_counter(), time.process_time()
dic.calculate_2d(
    reference=folder / "images" / "0_ref.tif",
    deformed=folder / "images" / "1_cur.tif",
    roi_mask=mask,
    seed=[471, 401],
    subset_size=43,
    subset_step=step,
    num_threads=2,
    method=method,
    image_filter_kernel=blur,
    max_displacement=16,
    output_basepath=out,
    print_level=0,
)
wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
data = dic.import_2d(data=str(out / "dic_results_*.csv"), layout="column", binary=False, delimiter=",")
x, y, u, v = (np.asarray(getattr(data, name), dtype=float).ravel() for name in ("ss_x", "ss_y", "u_px", "v_px"))
np.save(folder / "points.npy", np.stack([x, y, u, v]))
sys.stdout.write("\n" + json.dumps({"wall_s": wall, "cpu_s": cpu}) + "\n")
