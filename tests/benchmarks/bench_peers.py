"""Public DIC engines and ours on the same images in one run: ``python tests/benchmarks/bench_peers.py [--noise 0 2 5] [--step 5]``.

``--before CHECKOUT`` adds a row for another version of semlive, a checkout with compiled kernels in its cache. Both versions correlate
the pair in turns, in a process each, so that other work on the machine affects both alike. ``--only`` selects rows by parts of names.

pyvale and SUN-DIC are installed from the package index into environments of their own, kept in the user's cache folder (or
``--environments``). The job: 1024 x 884 px, 8 bit, 43 px subsets, 150 x 120 = 18,000 points 5 px apart, affine, ZNSSD, shift
(3.3, -2.7) px plus 1e-3 strain, noise of 0, 2 and 5 grey levels, speckle rendered analytically. Ours and pyvale use two threads;
SUN-DIC one process, because its two need a cluster's start-up. Clocks run around the call that correlates, kernels warm, ours
with everything that a new reference costs.

OpenCorr and ncorr are not on the package index: for them pyvale's figures of this run are multiplied by the ratio that was
measured side by side elsewhere (2 threads, 2 grey levels: 2.95 and 7.2 processor seconds, pyvale 5.42; their errors are
of that measurement too and not repeated here).
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import venv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "dic"))
from speckle import Affine, Speckle, expose

from semlive import dic
from semlive.kernels import threads

JOBS = Path(__file__).parent / "peers"
WIDTH, HEIGHT, ROI = 1024, 884, (101, 101, 846, 696)
POINTS = 18_000
MOTION = Affine(u=3.3, v=-2.7, ux=1e-3, vy=-3e-4, uy=2e-4, xc=473.5, yc=398.5)
OURS, PYVALE = "semlive", "pyvale, as it comes"
PACKAGES = {"pyvale": "pyvale==2026.10.2", "sundic": "SUN-DIC==0.0.35"}
PEERS = {
    PYVALE: ("pyvale", ("MULTIWINDOW_RG", "5")),
    "pyvale, single window": ("pyvale", ("SINGLEWINDOW_RG", "5")),
    "pyvale, single window, no blur": ("pyvale", ("SINGLEWINDOW_RG", "1")),
    "SUN-DIC": ("sundic", ()),
}
FASTEST_PYVALE = "pyvale, single window"
CPU_RATIO_TO_PYVALE = {"OpenCorr (ratio to pyvale)": 2.95 / 5.42, "ncorr (ratio to pyvale)": 7.2 / 5.42}
WALL_RATIO_TO_PYVALE = {"OpenCorr (ratio to pyvale)": 1.50 / 2.73, "ncorr (ratio to pyvale)": 4.1 / 2.73}
RUNS = 5
TURNS = 25  # of two versions of semlive


@dataclass(frozen=True)
class Result:
    """Seconds scaled to 18,000 points, and errors; None where only the time's ratio is known."""

    wall_s: float
    cpu_s: float
    points: int
    bias: tuple[float, float] | None = None
    sd: tuple[float, float] | None = None


@dataclass(frozen=True)
class Versions:
    """Processor seconds of one version of semlive, least and median of TURNS, and its valid points."""

    least_s: float
    median_s: float
    points: int


def interpreter(environments: Path, package: str) -> Path:
    """Python of the package's own environment, made if need be."""
    folder = environments / package
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    if not python.exists() or subprocess.run([python, "-c", f"import {package}"], capture_output=True).returncode:
        sys.stderr.write(f"installing {PACKAGES[package]} into {folder}\n")
        venv.create(folder, with_pip=True, clear=folder.exists())
        subprocess.run([python, "-m", "pip", "install", "--quiet", PACKAGES[package], "tifffile"], check=True, stderr=subprocess.DEVNULL)
    return python


def errors(points: NDArray[np.float64]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Mean and standard deviation of the error of u and v, failed points left out."""
    x, y, u, v = points[:, np.isfinite(points).all(axis=0)]
    true_u, true_v = MOTION.at(x, y)
    du, dv = u - true_u, v - true_v
    return (float(du.mean()), float(dv.mean())), (float(du.std()), float(dv.std()))


def peer(python: Path, package: str, arguments: tuple[str, ...], folder: Path, step: int) -> Result:
    """Run one engine in a process of its own."""
    job = [str(python), str(JOBS / f"{package}_job.py"), str(folder), str(step), *arguments]
    threads = {"NUMBA_NUM_THREADS": "1"} if package == "sundic" else {}  # its nested loops lock one another out otherwise
    done = subprocess.run(job, capture_output=True, text=True, env={**os.environ, **threads})
    if done.returncode:
        raise SystemExit(f"{package} failed:\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    clock = json.loads(done.stdout.strip().splitlines()[-1])
    points = np.load(folder / "points.npy")
    bias, sd = errors(points)
    scale = POINTS / points.shape[1]
    return Result(clock["wall_s"] * scale, clock["cpu_s"] * scale, points.shape[1], bias, sd)


def ours(first: NDArray[np.uint8], second: NDArray[np.uint8], step: int) -> Result:
    """Best of several runs, the new reference included."""
    settings = dic.DicSettings(step_px=step, roi_px=ROI)
    grid = dic.grid_for(settings, WIDTH, HEIGHT)
    dic.warm_up(settings)
    wall_s = cpu_s = float("inf")
    for _ in range(RUNS):
        wall, cpu = time.perf_counter(), time.process_time()
        found = dic.match(first, second, grid, settings)
        wall_s, cpu_s = min(wall_s, time.perf_counter() - wall), min(cpu_s, time.process_time() - cpu)
    x, y = grid.mesh()
    points = np.stack([a[found.valid] for a in (x, y, found.u_px, found.v_px)])
    bias, sd = errors(points)
    scale = POINTS / found.status.size
    return Result(wall_s * scale, cpu_s * scale, points.shape[1], bias, sd)


def in_turns(checkouts: dict[str, Path], folder: Path, step: int) -> dict[str, Versions]:
    """Processor seconds of versions of semlive that correlate the pair of a folder in turns."""
    arguments = [sys.executable, str(JOBS / "semlive_job.py"), str(folder), str(step), ",".join(map(str, ROI))]
    jobs = {
        name: subprocess.Popen(
            arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(checkout)}
        )
        for name, checkout in checkouts.items()
    }
    found: dict[str, list[dict[str, float]]] = {name: [] for name in jobs}
    for turn in range(TURNS):
        for name in sorted(jobs, reverse=bool(turn % 2)):
            job = jobs[name]
            assert job.stdin is not None
            assert job.stdout is not None
            job.stdin.write("\n")
            job.stdin.flush()
            found[name].append(json.loads(job.stdout.readline()))
    for job in jobs.values():
        job.communicate()
    return {
        name: Versions(min(r["cpu_s"] for r in runs), statistics.median(r["cpu_s"] for r in runs), int(runs[0]["points"]))
        for name, runs in found.items()
    }


def line(noise: float, name: str, r: Result, base: Result) -> str:
    """One row of the table."""
    bias = f"{r.bias[0]:+.1e} / {r.bias[1]:+.1e}" if r.bias else "-"
    sd = f"{r.sd[0]:.2e} / {r.sd[1]:.2e}" if r.sd else "-"
    count = f"{r.points}" if r.bias else "-"
    return f"| {noise:.0f} | {name} | {r.wall_s:.3f} | {r.cpu_s:.3f} | {r.cpu_s / base.cpu_s:.1f} | {bias} | {sd} | {count} |\n"


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 2.0, 5.0])
    parser.add_argument("--step", type=int, default=5, help="distance of points; larger ones are scaled to 18,000 points")
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    parser.add_argument("--environments", type=Path, default=cache / "semlive" / "peers")
    parser.add_argument("--before", type=Path, help="checkout of another version of semlive, measured in turns with this one")
    parser.add_argument("--only", nargs="+", default=[""], help="parts of names of the engines to run")
    options = parser.parse_args()
    peers = {name: job for name, job in PEERS.items() if any(part in name for part in options.only)}
    pythons = {package: interpreter(options.environments, package) for package in {package for package, _ in peers.values()}}
    speckle = Speckle(WIDTH, HEIGHT)
    images = speckle.render(), speckle.render(MOTION)
    sys.stdout.write(f"threads of semlive: {threads.thread_count()}\n")
    sys.stdout.write("| noise, grey | engine | wall s / 18k | CPU s / 18k | CPU ratio | bias u / v, px | sd u / v, px | points |\n")
    sys.stdout.write("|---|---|---|---|---|---|---|---|\n")
    for noise in options.noise:
        first, second = (expose(image, noise, seed) for seed, image in enumerate(images))
        base = ours(first, second, options.step)
        sys.stdout.write(line(noise, OURS, base, base))
        with tempfile.TemporaryDirectory() as folder:
            pair = Path(folder) / "images"
            pair.mkdir()
            tifffile.imwrite(pair / "0_ref.tif", first)
            tifffile.imwrite(pair / "1_cur.tif", second)
            if options.before is not None:
                for name, v in in_turns(
                    {"before": options.before, "present": Path(__file__).parents[2]}, Path(folder), options.step
                ).items():
                    sys.stdout.write(
                        f"semlive, {name}, in turns: {v.least_s:.4f} s CPU at least, {v.median_s:.4f} s median, {v.points} points\n"
                    )
            for name, (package, arguments) in peers.items():
                result = peer(pythons[package], package, arguments, Path(folder), options.step)
                sys.stdout.write(line(noise, name, result, base))
                sys.stdout.flush()
                if name == FASTEST_PYVALE:
                    for other, ratio in CPU_RATIO_TO_PYVALE.items():
                        reported = Result(result.wall_s * WALL_RATIO_TO_PYVALE[other], result.cpu_s * ratio, POINTS)
                        sys.stdout.write(line(noise, other, reported, base))


if __name__ == "__main__":
    main()
