"""Speed, memory and accuracy of the DIC engine, each with its bar: ``python tests/benchmarks/bench_dic.py [quick|accuracy]``.

The job: 1024 x 884 px, 8 bit, subset 43, 150 x 120 = 18,000 POI 5 px apart, shift (3.3, -2.7) px plus 1e-3 strain, speckle of
6.7 px, rendered analytically. Times are the best of RUNS, taken in turns (one and two threads, new and kept reference), so that
other work of the machine affects all equally; the median next to it shows how much that was. ``quick`` skips the large frames,
``accuracy`` everything except the errors.

Two processors of a machine rarely give twice one: virtual ones share a core at times, and all share memory. So the same work is
also done, in the same turns, by one process of one thread and by two such processes at once, which share nothing: what these give
is what threads can give at best (`machine gives`).
"""

from __future__ import annotations

import multiprocessing
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import cv2
import numpy as np
from numba.core import config
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "dic"))
from speckle import Affine, Speckle, expose

from semlive import dic
from semlive.data.grid import Grid
from semlive.data.settings import DicSettings
from semlive.dic.correlate import ORDER
from semlive.dic.initial_guess.fields import smooth_field
from semlive.dic.initial_guess.search import match
from semlive.kernels import images, threads
from semlive.kernels.subset_matching import interface
from semlive.kernels.subset_matching.icgn import SEED_FROM_NEIGHBOUR

RUNS = 15
TURNS = 3  # of RUNS, for ratios
DRAWS = 10  # of noise, for errors
SETTINGS = DicSettings()
STRAIN = Affine(u=3.3, v=-2.7, ux=1e-3, vy=-3e-4, uy=2e-4, xc=473.5, yc=398.5)
FRAME = (1024, 884)
MEMORY = """
import sys
import numpy as np
from semlive import dic
from semlive.data.settings import DicSettings

def peak():  # not ru_maxrss, which begins with the parent's
    return int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0]) / 1024

imported = peak()
first, second = np.load(sys.argv[1])
settings = DicSettings()
dic.match(first, second, dic.grid_for(settings, 1024, 884), settings)
print(imported, peak())
"""


@dataclass
class Watch:
    """Wall and processor seconds of several runs of something."""

    wall: list[float]
    cpu: list[float]

    def run(self, work: Callable[[], object]) -> None:
        """Time of a repeated call."""
        wall, cpu = time.perf_counter(), time.process_time()
        work()
        self.wall.append(time.perf_counter() - wall)
        self.cpu.append(time.process_time() - cpu)


def report(what: str, value: float, unit: str, bar: str = "") -> None:
    """One line."""
    sys.stdout.write(f"{what:58} {value:9.3f} {unit:10} {bar}\n")
    sys.stdout.flush()


def in_turns(jobs: dict[tuple[str, int], Callable[[], object]]) -> dict[tuple[str, int], Watch]:
    """Run jobs, named by what they do and their number of threads, in turns."""
    watches = {key: Watch([], []) for key in jobs}
    usual = threads.thread_count()
    for _ in range(RUNS):
        for key, work in jobs.items():
            config.NUMBA_NUM_THREADS = key[1]  # what NUMBA_NUM_THREADS sets, and all that `threads.thread_count` reads
            watches[key].run(work)
    config.NUMBA_NUM_THREADS = usual
    return watches


def pair_of_work(first: NDArray[np.uint8], second: NDArray[np.uint8], grid: Grid) -> dict[str, Callable[[], object]]:
    """The work that is compared with two processes: the complete pair and IC-GN alone."""

    def new() -> object:
        prepared = dic.prepare(first, grid, SETTINGS)
        return dic.correlate(prepared, second, SETTINGS, reference_frame=0, current_frame=1)

    return {"new reference, 2 grey": new, "IC-GN alone, 2 grey": kernel(dic.prepare(first, grid, SETTINGS), second, grid)}


def obey(orders: Connection, first: NDArray[np.uint8], second: NDArray[np.uint8], grid: Grid) -> None:
    """A process of one thread: does the work that it receives and reports its end, until it receives nothing."""
    config.NUMBA_NUM_THREADS = 1
    work = pair_of_work(first, second, grid)
    for job in work.values():
        job()
    orders.send("ready")
    while what := orders.recv():
        work[what]()
        orders.send("done")


@contextmanager
def two_processes(first: NDArray[np.uint8], second: NDArray[np.uint8], grid: Grid) -> Iterator[list[Connection]]:
    """Two that `obey`."""
    context = multiprocessing.get_context("spawn")
    ends, processes = [], []
    for _ in range(2):
        mine, theirs = context.Pipe()
        processes.append(context.Process(target=obey, args=(theirs, first, second, grid), daemon=True))
        processes[-1].start()
        ends.append(mine)
    for end in ends:
        end.recv()
    yield ends
    for end, process in zip(ends, processes, strict=True):
        end.send("")
        process.join()


def together(ends: list[Connection], what: str) -> Callable[[], object]:
    """The same work by each of these processes at once."""

    def work() -> None:
        for end in ends:
            end.send(what)
        for end in ends:
            end.recv()

    return work


def scaling(pair: tuple[NDArray[np.uint8], NDArray[np.uint8]], grid: Grid) -> None:
    """Gain of two threads, compared with the gain of two processes at the same time."""
    jobs: dict[tuple[str, int], Callable[[], object]] = {}
    works = pair_of_work(*pair, grid)
    with two_processes(*pair, grid) as ends:
        for what, work in works.items():
            jobs[what, 1] = jobs[what, 2] = work
            jobs[f"{what}, one process", 1] = together(ends[:1], what)
            jobs[f"{what}, two processes", 1] = together(ends, what)
        turns = [in_turns(jobs) for _ in range(TURNS)]
    best = {key: min(min(watches[key].wall) for watches in turns) for key in jobs}
    for what, bar in (("IC-GN alone, 2 grey", "1.8"), ("new reference, 2 grey", "1.6")):
        ours = best[what, 1] / best[what, 2]
        machine = 2.0 * best[f"{what}, one process", 1] / best[f"{what}, two processes", 1]
        report(f"{what}, one thread over two", ours, "x wall", f"bar {bar}")
        report("machine gives: two processes over one", machine, "x work", f"ours is {100.0 * ours / machine:.0f} % of it")


def kernel(reference: dic.Reference, image: NDArray[np.uint8], grid: Grid) -> Callable[[], object]:
    """IC-GN alone, from the first guesses on."""
    current = images.to_float32_grey(image)
    seeds = smooth_field(match(reference.coarse, current), grid)
    interpolator = images.interpolator(current, ORDER[SETTINGS.interpolation])
    todo = np.full(grid.shape, SEED_FROM_NEIGHBOUR, dtype=np.uint8)
    out = interface.Solutions(
        np.zeros((*grid.shape, 6)), np.zeros(grid.shape), np.zeros(grid.shape, np.uint8), np.zeros(grid.shape, np.int32)
    )
    limits = {"max_iterations": SETTINGS.max_iterations, "tolerance_px": SETTINGS.tolerance_px, "min_zncc": SETTINGS.min_zncc}
    return lambda: interface.correlate(reference.sums, interpolator, todo, seeds, out, max_travel_px=8.0, **limits)


def speed(pairs: dict[int, tuple[NDArray[np.uint8], NDArray[np.uint8]]], grid: Grid) -> None:
    """The times of the job."""
    jobs: dict[tuple[str, int], Callable[[], object]] = {}
    for noise, (first, second) in pairs.items():
        reference = dic.prepare(first, grid, SETTINGS)

        def with_reference(reference: dic.Reference = reference, second: NDArray[np.uint8] = second) -> object:
            return dic.correlate(reference, second, SETTINGS, reference_frame=0, current_frame=1)

        def new(first: NDArray[np.uint8] = first, second: NDArray[np.uint8] = second) -> object:
            prepared = dic.prepare(first, grid, SETTINGS)
            return dic.correlate(prepared, second, SETTINGS, reference_frame=0, current_frame=1)

        for count in (1, 2):
            jobs[f"new reference, {noise} grey", count] = new
            jobs[f"kept reference, {noise} grey", count] = with_reference
            jobs[f"IC-GN alone, {noise} grey", count] = kernel(reference, second, grid)
    watches = in_turns(jobs)
    bars = {"new reference, 2 grey": ("0.15", "0.27"), "new reference, 5 grey": ("0.25", ""), "kept reference, 2 grey": ("0.12", "")}
    for (what, count), watch in watches.items():
        wall, cpu = bars.get(what, ("", "")) if count == 2 else ("", "")
        for unit, values, bar in (("s wall", watch.wall, wall), ("s CPU", watch.cpu, cpu)):
            report(f"{what}, {count} threads (median {np.median(values):.3f})", min(values), unit, bar and f"bar {bar}")


def bounds(speckle: Speckle, grid: Grid) -> NDArray[np.float64]:
    """(2, 2) least variances of u and v for image noise of variance 1 in both frames: of a shift alone, and of what a subset determines.

    Cramer-Rao bounds with derivatives of the rendered pattern itself; central differences have 12 % less energy. A subset determines an
    affine displacement, an offset and a gain. Mean over subsets that do not overlap.
    """
    h = 0.05
    along = [
        (speckle.render(Affine(**{name: -h})) - speckle.render(Affine(**{name: h}))) / (2.0 * h)  # type: ignore[arg-type]
        for name in ("u", "v")
    ]
    f, half, every = speckle.render(), grid.subset_px // 2, -(-grid.subset_px // grid.step_px)
    y, x = (a.ravel().astype(float) for a in np.mgrid[-half : half + 1, -half : half + 1])
    found = []
    for row in grid.y_px[::every].astype(int):
        for column in grid.x_px[::every].astype(int):
            gx, gy, grey = (a[row - half : row + half + 1, column - half : column + half + 1].ravel() for a in (*along, f))
            columns = np.stack([gx, gy, gx * x, gx * y, gy * x, gy * y, np.ones_like(gx), grey])
            everything = 2.0 * np.diag(np.linalg.inv(columns @ columns.T))[:2]
            found.append([[2.0 / (gx @ gx), 2.0 / (gy @ gy)], everything])
    return np.mean(found, axis=0)


def accuracy(rendered: tuple[NDArray[np.float64], NDArray[np.float64]], grid: Grid, least: NDArray[np.float64], draws: int = DRAWS) -> None:
    """Errors of one pair with several draws of noise; `bench_dic_accuracy.py` pools other shifts.

    The noise of rounding to grey levels is part of the floor. A single draw has 240 independent subsets, so its standard deviation is
    known to 3 % only.
    """
    true = STRAIN.at(*grid.mesh())
    for noise in (0.0, 2.0, 5.0, 7.0):
        errors, stated, iterations, converged = [], [], [], []
        for draw in range(draws if noise else 1):
            first, second = (expose(image, noise, 2 * draw + k) for k, image in enumerate(rendered))
            reference = dic.prepare(first, grid, SETTINGS)
            m = dic.correlate(reference, second, SETTINGS, reference_frame=0, current_frame=1)
            errors.append([np.where(m.valid, value - t, np.nan) for value, t in zip((m.u_px, m.v_px), true, strict=True)])
            stated.append([np.mean(np.square(sigma[m.valid])) for sigma in (m.sigma_u_px, m.sigma_v_px)])
            iterations.append(m.iterations[m.valid].mean())
            converged.append(m.valid.mean())
        error = np.array(errors)  # (draws, 2, ny, nx)
        each = np.nanvar(error, axis=(2, 3))
        variance, scatter = each.mean(axis=0), each.std(axis=0) / np.sqrt(max(len(each) - 1, 1))
        shift, subset = (np.sqrt(variance / (floor * (noise**2 + 1.0 / 12.0))) for floor in least)
        spread = 0.5 * subset * scatter / variance
        found = np.sqrt(np.mean(stated, axis=0) / variance)
        bias, sd = np.nanmean(error, axis=(0, 2, 3)), np.sqrt(variance)
        sys.stdout.write(
            f"noise {noise:.0f}, {len(error)} draws: {np.mean(iterations):.2f} iterations, converged {100 * np.mean(converged):.2f} %; "
            f"bias {bias[0]:+.1e} {bias[1]:+.1e}, sd {sd[0]:.2e} {sd[1]:.2e}, over the bound of a shift {shift[0]:.3f} {shift[1]:.3f}, "
            f"of an affine subset {subset[0]:.3f} {subset[1]:.3f} +- {spread.max():.3f} (bar 1.02), "
            f"stated/found {found[0]:.3f} {found[1]:.3f}\n"
        )


def speckled(width: int, height: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """A pair of any size, shifted by (5, -3) px, 5 grey of noise."""
    rng = np.random.default_rng(7)
    smooth = cv2.GaussianBlur(rng.standard_normal((height + 16, width + 16), dtype=np.float32), (0, 0), 2.0)
    frames = []
    for x, y in ((0, 0), (5, -3)):
        cut = 276.0 * smooth[8 - y : 8 - y + height, 8 - x : 8 - x + width]
        frames.append(np.clip(128.0 + cut + 5.0 * rng.standard_normal(cut.shape, dtype=np.float32), 0, 255).astype(np.uint8))
    return frames[0], frames[1]


def sizes() -> None:
    """Time per point over the number of points, and a large frame."""
    for nx, ny, runs in ((40, 25, 10 * RUNS), (125, 80, 2 * RUNS), (400, 250, 3), (1250, 800, 1)):
        width, height = (nx - 1) * 5 + 103, (ny - 1) * 5 + 103
        settings = DicSettings(roi_px=(51, 51, width - 52, height - 52))
        grid = dic.grid_for(settings, width, height)
        first, second = speckled(width, height)
        watch = Watch([], [])
        for _ in range(runs):
            watch.run(lambda: dic.match(first, second, grid, settings))  # noqa: B023
        report(
            f"{grid.nx * grid.ny} points, {width} x {height} px, per point",
            1e6 * min(watch.cpu) / (grid.nx * grid.ny),
            "us CPU",
            "bar: flat",
        )
    settings = DicSettings(step_px=10, roi_px=(48, 48, 48 + 3990, 48 + 3990))
    grid = dic.grid_for(settings, 4096, 4096)
    first, second = speckled(4096, 4096)
    watch = Watch([], [])
    for _ in range(3):
        watch.run(lambda: dic.match(first, second, grid, settings))
    report(f"4096 x 4096 px, {grid.nx * grid.ny} points", min(watch.wall), "s wall", "bar 3")
    report("", min(watch.cpu), "s CPU")


def faults(work: Callable[[], object]) -> None:
    """Pages fetched from the system and its time for a pair, which two threads wait for one another in."""
    usual = threads.thread_count()
    for count in (1, 2):
        config.NUMBA_NUM_THREADS = count
        work()
        before = resource.getrusage(resource.RUSAGE_SELF)
        for _ in range(RUNS):
            work()
        after = resource.getrusage(resource.RUSAGE_SELF)
        report(f"page faults of a pair, {count} threads", (after.ru_minflt - before.ru_minflt) / RUNS, "")
        report("system time of a pair", 1e3 * (after.ru_stime - before.ru_stime) / RUNS, "ms")
    config.NUMBA_NUM_THREADS = usual


def memory(pair: tuple[NDArray[np.uint8], NDArray[np.uint8]], folder: Path) -> None:
    """Peak of a process that does the job once."""
    path = folder / "pair.npy"
    np.save(path, np.stack(pair))
    done = subprocess.run([sys.executable, "-c", MEMORY, str(path)], check=True, capture_output=True, text=True)
    imported, peak = (float(word) for word in done.stdout.split())
    report("peak memory of a process that does it", peak, "MB", "bar 400")
    report("of that, the interpreter and its imports", imported, "MB")


def main() -> None:
    """Run and print."""
    start = time.perf_counter()
    dic.warm_up(SETTINGS)
    sys.stdout.write(f"warm-up {time.perf_counter() - start:.1f} s\n")
    smoke = "smoke" in sys.argv[1:]
    frame = (320, 276) if smoke else FRAME
    speckle = Speckle(*frame)
    images = speckle.render(), speckle.render(STRAIN)
    grid = dic.grid_for(SETTINGS, *frame)
    if "accuracy" in sys.argv[1:]:
        accuracy(images, grid, bounds(speckle, grid))
        return
    pairs = {noise: (expose(images[0], noise, 0), expose(images[1], noise, 1)) for noise in (2, 5)}
    speed(pairs, grid)
    if smoke:
        accuracy(images, grid, bounds(speckle, grid), draws=2)
        return
    scaling(pairs[2], grid)
    with tempfile.TemporaryDirectory() as folder:
        memory(pairs[2], Path(folder))
    faults(pair_of_work(*pairs[2], grid)["new reference, 2 grey"])
    if "quick" not in sys.argv[1:]:
        sizes()
    accuracy(images, grid, bounds(speckle, grid))


if __name__ == "__main__":
    main()
