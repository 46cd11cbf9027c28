"""Correlate rows about the middle line with pyvale, in pyvale's environment: reference, current, output, row, subset, shape, blur."""

import sys
import tempfile
from pathlib import Path

import numpy as np
from pyvale import dic

reference, current, output, row, subset, shape, blur = sys.argv[1:]
height, width = (int(n) for n in np.load(output).tolist())
half = int(subset) // 2
mask = np.zeros((height, width), dtype=bool)
mask[int(row) - half - 2 : int(row) + half + 3] = True
with tempfile.TemporaryDirectory() as folder:
    dic.calculate_2d(
        reference=Path(reference),
        deformed=Path(current),
        roi_mask=mask,
        seed=[width - 500, int(row)],  # where the wave is longest
        subset_size=int(subset),
        subset_step=1,
        shape_function=shape,
        num_threads=2,
        image_filter_kernel=int(blur),
        max_displacement=16,
        output_basepath=Path(folder),
        print_level=0,
    )
    data = dic.import_2d(data=str(Path(folder) / "dic_results_*.csv"), layout="column", binary=False, delimiter=",")
x, y, v = (np.asarray(getattr(data, name), dtype=float).ravel() for name in ("ss_x", "ss_y", "v_px"))
line = np.full(width, np.nan)
on = (np.rint(y) == int(row)) & np.isfinite(v)
line[np.rint(x[on]).astype(int)] = v[on]
np.save(output, line)
