"""Star 5 of the DIC Challenge 2.0 itself, ours and pyvale side by side: ``python tests/benchmarks/bench_challenge_star.py``.

The images (4000 x 501 px, 8 bit, noise that grows with the grey level) come inside pyvale's package; they are read from the
environment that ``bench_peers.py`` makes, and are not part of this repository. Their displacement is v = 0.5 cos(2 pi (y - 250) /
period) px, where the period grows from 10 px at the left to 300 px at the right; on the middle line the truth is 0.5 px everywhere.

Definitions (Reu et al. 2022, doi:10.1007/s11340-021-00806-6): *spatial resolution* is the period at which a polynomial of 12th
order through measured over true displacement along the middle line first rises through 90 %; *measurement resolution* the standard
deviation along that line between two exposures that did not move; their product is the metrological efficiency indicator (MEI),
smaller is better; a code's figure is the mean of its three lowest.

The exposure that did not move is not in the package. It is made here: the reference with as much noise added as two exposures
differ by, the variance for each grey level taken from where the true displacement of the pair is a whole number. With
``--still FILE`` the Challenge's own (DIC_Challenge_Star_Noise.tif) is taken instead.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray
from scipy import ndimage

sys.path.insert(0, str(Path(__file__).parent))
from bench_peers import interpreter

from semlive import dic
from semlive.dic.correlate import ORDER, solve
from semlive.dic.initial_guess.search import match
from semlive.kernels import images

SUBSETS = (9, 13, 17, 21, 25, 33, 41, 49)
AMPLITUDE_PX, DEGREE, PASSED = 0.5, 12, 0.9
SIDE = 2  # rows of points on each side of the middle one, so that points have neighbours
JOB = Path(__file__).parent / "peers" / "pyvale_star_job.py"
FIND = "import importlib.util; print(importlib.util.find_spec('pyvale').submodule_search_locations[0])"
# MEI for displacement of the entries, px^2: from the line cuts that the participants handed in, by the definitions above, as
# published in the repository iCorrVision/iCorrVision-2D, data/star56/participant_mei_frozen.csv
ENTRIES = {
    "Local.Affine.A": 0.602, "Local.Affine.B": 0.566, "Local.Affine.C": 0.361, "Local.Affine.D": 0.654, "Local.Affine.E": 0.597,
    "Local.Affine.F": 0.541, "Local.Affine.G": 1.023, "Local.Affine.H": 0.573, "Local.Quad.A": 0.356, "Local.Quad.B": 0.368,
    "Local.Quad.C": 0.364, "Local.Quad.D": 0.364, "Global.A": 0.773, "Global.B": 0.421, "Global.C": 0.690, "Global.D": 0.379,
    "Global.E": 0.575, "Global.F": 0.397, "Global.G": 0.430, "Misc.A": 0.428, "Misc.B": 0.614, "Misc.C": 0.592, "Misc.D": 0.574,
    "Misc.E": 0.527, "Misc.F": 0.647,
}  # fmt: skip

Image = NDArray[np.uint8]
Line = NDArray[np.float64]
Measure = Callable[[Image, Image, int], Line]  # reference, current, subset: v along the middle line, NaN where there is none


@dataclass(frozen=True)
class Cut:
    """Figures of a middle line."""

    subset_px: int
    resolution_px: float
    noise_px: float
    points: float

    @property
    def mei_px2(self) -> float:
        """Metrological efficiency indicator."""
        return self.resolution_px * self.noise_px


def period_px(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Period at a column."""
    return 10.0 + 290.0 / 4000.0 * x


def resolution_px(v: Line) -> float:
    """Period at which the polynomial first rises through 90 %; NaN if it does nowhere."""
    measured = np.isfinite(v)
    period = period_px(np.arange(v.size, dtype=float))
    if measured.sum() <= DEGREE:
        return float("nan")
    fit = np.polynomial.Polynomial.fit(period[measured], v[measured] / AMPLITUDE_PX, DEGREE)
    fine = np.linspace(period[measured].min(), period[measured].max(), 20_000)
    passed = fit(fine) >= PASSED
    rises = np.flatnonzero(~passed[:-1] & passed[1:])
    return float(fine[rises[0] + 1]) if rises.size else float("nan")


def noise_by_grey(reference: Image, moved: Image) -> tuple[float, float]:
    """Variance of one exposure's noise as (at grey level 0, per grey level), where the motion is a whole number of pixels."""
    height, width = reference.shape
    y, x = np.mgrid[0:height, 0:width].astype(float)
    v = AMPLITUDE_PX * np.cos(2.0 * np.pi * (y - height // 2) / period_px(x))
    back = ndimage.map_coordinates(moved.astype(float), [y + v, x], order=5, mode="mirror")
    whole = (np.abs(v) < 0.02) & (period_px(x) > 80.0)
    whole[:20] = whole[-20:] = False
    grey, square = reference[whole].astype(float), 0.5 * (back - reference)[whole] ** 2
    slope, level = np.polyfit(grey, square, 1)
    return float(level), float(slope)


def still(reference: Image, moved: Image, seed: int = 1) -> Image:
    """The reference as another exposure would differ from it."""
    level, slope = noise_by_grey(reference, moved)
    variance = np.maximum(2.0 * (level + slope * reference) - 1.0 / 12.0, 0.0)  # rounding adds the rest
    noise = np.random.default_rng(seed).standard_normal(reference.shape) * np.sqrt(variance)
    return np.clip(np.rint(reference + noise), 0, 255).astype(np.uint8)


def ours(believed: bool = False, **options: str) -> Measure:
    """Our engine: every point where IC-GN converges, or only those that are consistent with the complete map.

    Where a wave bends much within a subset, points are refused. The other codes keep them, and the polynomial runs through them,
    which makes resolutions 5 % coarser: 71 px for the transfer function of affine subsets of 17 px, which passes 90 % at 67.8 px.
    """

    def measure(reference: Image, current: Image, subset: int) -> Line:
        height, width = reference.shape
        half, row = subset // 2, height // 2
        roi = (half, row - SIDE, width - 1 - half, row + SIDE)
        settings = dic.DicSettings(subset_px=subset, step_px=1, roi_px=roi, **options)  # pyright: ignore[reportArgumentType]
        grid = dic.grid_for(settings, width, height)
        prepared, grey = dic.prepare(reference, grid, settings), images.to_float32_grey(current)
        found = solve(prepared, images.interpolator(grey, ORDER[settings.interpolation]), match(prepared.coarse, grey), settings)
        v, valid = found.parameters[..., 3], found.status == dic.PoiStatus.CONVERGED
        if believed:
            valid = dic.correlate(prepared, current, settings, reference_frame=0, current_frame=1).valid
        line = np.full(width, np.nan)
        line[grid.x_px.astype(int)] = np.where(valid, v, np.nan)[SIDE]
        return line

    return measure


def pyvale(python: Path, shape: str, blur: int) -> Measure:
    """pyvale in its environment."""

    def measure(reference: Image, current: Image, subset: int) -> Line:
        with tempfile.TemporaryDirectory() as folder:
            paths = [Path(folder) / name for name in ("reference.tiff", "current.tiff", "line.npy")]
            tifffile.imwrite(paths[0], reference)
            tifffile.imwrite(paths[1], current)
            np.save(paths[2], np.array(reference.shape))
            job = [str(python), str(JOB), *map(str, paths), str(reference.shape[0] // 2), str(subset), shape, str(blur)]
            done = subprocess.run(job, capture_output=True, text=True)
            if done.returncode:
                raise SystemExit(f"pyvale failed:\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
            return np.load(paths[2])

    return measure


def cut(measure: Measure, reference: Image, moved: Image, unmoved: Image, subset: int) -> Cut:
    """Both measurements with one subset size."""
    line = measure(reference, moved, subset)
    noise = measure(reference, unmoved, subset)
    inside = slice(subset // 2, line.size - subset // 2)
    return Cut(subset, resolution_px(line), float(np.nanstd(noise)), float(np.isfinite(line[inside]).mean()))


def summary_px2(cuts: list[Cut]) -> float:
    """A code's figure: the mean of its three lowest."""
    return float(np.mean(sorted(c.mei_px2 for c in cuts if np.isfinite(c.mei_px2))[:3]))


def print_line(text: str) -> None:
    """A line at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def main() -> None:
    """Run and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    parser.add_argument("--environments", type=Path, default=cache / "semlive" / "peers")
    parser.add_argument("--still", type=Path, help="the Challenge's exposure that did not move")
    parser.add_argument("--seed", type=int, default=1, help="of the noise of the exposure that did not move")
    parser.add_argument("--engines", nargs="+", help="some of them, by the first part or all of their name")
    parser.add_argument("--subsets", type=int, nargs="+", default=SUBSETS)
    requests = parser.parse_args()
    python = interpreter(requests.environments, "pyvale")
    package = subprocess.run([python, "-c", FIND], check=True, capture_output=True, text=True).stdout.strip()
    images = Path(package) / "data" / "dic" / "challenge"
    reference, moved = (tifffile.imread(images / f"DIC_Challenge_Star_Noise_{which}.tiff") for which in ("Ref", "Def"))
    level, slope = noise_by_grey(reference, moved)
    print_line(f"noise variance of an exposure: {level:.2f} + {slope:.4f} x grey level")
    unmoved = tifffile.imread(requests.still) if requests.still else still(reference, moved, requests.seed)
    engines: dict[str, Measure] = {
        "semlive, affine": ours(),
        "semlive, quadratic": ours(shape_function="quadratic"),
        "semlive, quartic": ours(shape_function="quartic"),
        "semlive, affine, believed alone": ours(believed=True),
        "pyvale as it comes, affine": pyvale(python, "AFFINE", 5),
        "pyvale as it comes, quadratic": pyvale(python, "QUAD", 5),
        "pyvale without blur, quadratic": pyvale(python, "QUAD", 1),
    }
    print_line("| engine | subset px | resolution px | noise px | MEI px^2 | of the line found % |\n|---|---|---|---|---|---|")
    figures = dict(ENTRIES)
    for name, measure in engines.items():
        if requests.engines and not {name, name.split()[0].rstrip(",")} & set(requests.engines):
            continue
        cuts = [cut(measure, reference, moved, unmoved, subset) for subset in requests.subsets]
        for c in cuts:
            print_line(f"| {name} | {c.subset_px} | {c.resolution_px:.1f} | {c.noise_px:.4f} | {c.mei_px2:.3f} | {100.0 * c.points:.1f} |")
        if "believed" not in name:
            figures[f"**{name}**"] = summary_px2(cuts)
    print_line("\n| rank | entry | MEI px^2 |\n|---|---|---|")
    for rank, (name, value) in enumerate(sorted(figures.items(), key=lambda item: item[1]), start=1):
        print_line(f"| {rank} | {name} | {value:.3f} |")


if __name__ == "__main__":
    main()
