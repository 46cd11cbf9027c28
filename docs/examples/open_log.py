"""A log in Python: cells for Jupyter, VS Code or Spyder; as a script ``python docs/examples/open_log.py LOG.mcap``."""

# %%
from __future__ import annotations

import sys

import numpy as np

import semlive

log = semlive.open_log(sys.argv[1])
sys.stdout.write(f"{log!r}\n")

# %% [markdown]
# ## What came out
# `log.result` is what `semlive replay --json` prints; `log.series` has one number for each frame.

# %%
for name, value in log.elastic.items():
    sys.stdout.write(f"{name}: {value:.4g}\n")
series = log.series
for frame, phase, load_n, eyy in zip(series["frame"], series["phase"], series["load_n"], series["eyy_mean"], strict=True):
    sys.stdout.write(f"frame {frame:3d}  {phase:12s} {load_n:8.1f} N  eyy {1e6 * eyy:8.1f} 1e-6\n")

# %% [markdown]
# ## Fields
# One frame is an object of (ny, nx) arrays in px of frame 0, corrected for drift and distortion. Only points with `valid` count.

# %%
last = log.frames[-1]
inside = last.valid
rigid_px = last.u[inside].mean(), last.v[inside].mean()
sys.stdout.write(f"frame {last.number} moved by ({rigid_px[0]:.3f}, {rigid_px[1]:.3f}) px, noise {last.sigma_u[inside].mean():.4f} px\n")
sys.stdout.write(f"eyy over the field: {1e6 * last.eyy[last.strain_valid].std():.0f} 1e-6 from gauge to gauge\n")

# %% [markdown]
# ## Drift and distortion

# %%
rate_px_min = 60 * np.gradient(log.drift.dy_px, log.drift.time_s)
sys.stdout.write(
    f"drift along y: {log.drift.dy_px[-1]:.2f} px in {log.drift.time_s[-1] / 60:.0f} min, at most {np.abs(rate_px_min).max():.2f} px/min\n"
)
sys.stdout.write(f"distortion: up to {np.abs(log.distortion.dx_px[log.distortion.valid]).max(initial=0.0):.2f} px along x\n")

# %% [markdown]
# ## xarray
# A cube over (frame, y, x), NaN where nothing was measured: `cube.eyy.sel(frame=7).plot()`.

# %%
cube = log.to_xarray(frames=log.frames.numbers[-2:])
sys.stdout.write(f"{dict(cube.sizes)} {float(cube.eyy.mean()):.3e}\n")
