"""Correlation of real raster pairs against reference displacements: ``python tests/benchmarks/bench_real_rasters.py FOLDER [--write]``.

FOLDER holds images (PNG) and, for each pair, ``FIRST__SECOND.csv`` with the columns x, y, u, v, zncc: blocks whose displacement two
estimates of another program agree on. Each block represents the area within half the distance of the blocks; the points of the default
grid in it are compared with it. A third measure shows which of the two is off where they differ: the enhanced correlation coefficient of
OpenCV (Evangelidis, Psarakis 2008, doi:10.1109/TPAMI.2008.113) on the grey levels of the same blocks, with an affine motion, started from
the reference. With ``--write`` the tables also go to docs/validation/real-rasters.md.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[2]))

from semlive import dic
from semlive.data.disparity import DisparityMap
from semlive.data.settings import DicSettings

BLOCK_DISTANCE_PX = 12.0
REFERENCE_ERROR_PX = 0.3  # uncertainty of the reference displacements
WRONG_PX = 2.0
THIRD_BLOCK_PX = 49
THIRD_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-5)
THIRD_REACH_PX = 5.0  # a farther solution has diverged
PAGE = Path(__file__).parents[2] / "docs" / "validation" / "real-rasters.md"
COLUMNS = (
    "pair", "method", "area %", "median du / dv px", "median magnitude du / dv px", "within 3 sigma + 0.3 px %", "wrong %",
    "median sigma u / v px", "neighbour share", "cpu s",
)  # fmt: skip
THIRD_COLUMNS = (
    "pair", "blocks", "third - reference: median du / dv px", "measured - third: median du / dv px",
    "median magnitude: third - reference px", "measured - third px", "measured - reference px", "wrong blocks", "of these nearer to third",
)  # fmt: skip

Array = NDArray[np.float64]
Image = NDArray[np.float32]


@dataclass(frozen=True)
class Comparison:
    """Comparison of one map with its reference.

    Attributes:
        name: the pair.
        disparity: the map.
        cpu_s: processor time.
        points: points of the grid in the area of the reference.
        difference_px: (n, 2) u and v of the converged points among them minus the reference.
        sigma_px: (n, 2) their standard uncertainties.
        neighbour_share: median part of a value from neighbours and smoothness.
        blocks: (n, 3, 2) u and v of the reference, mean of the map and third measure, for blocks that all three have.
    """

    name: str
    disparity: DisparityMap
    cpu_s: float
    points: int
    difference_px: Array
    sigma_px: Array
    neighbour_share: float
    blocks: Array

    def third_row(self) -> tuple[str, ...]:
        """Cells of the table of the third measure, as `THIRD_COLUMNS`."""
        reference, measured, third = (self.blocks[:, k] for k in range(3))
        differences = third - reference, measured - third, measured - reference
        middle = [np.median(d, axis=0) for d in differences]
        size = [f"{a:.3f} / {b:.3f}" for a, b in (np.median(np.abs(d), axis=0) for d in differences)]
        far = [np.hypot(*d.T) for d in differences]
        wrong = far[2] > WRONG_PX
        nearer = wrong & (far[1] < far[0])
        return (
            self.name, str(len(self.blocks)), *(f"{m[0]:+.3f} / {m[1]:+.3f}" for m in middle[:2]), *size,
            str(int(np.count_nonzero(wrong))), str(int(np.count_nonzero(nearer))),
        )  # fmt: skip

    def row(self) -> tuple[str, ...]:
        """Cells of the table, as `COLUMNS`."""
        d, s = self.difference_px, self.sigma_px
        if not len(d):
            return (self.name, self.disparity.method, "0.0", "", "", "", "", "", "", f"{self.cpu_s:.1f}")
        middle, size, sigma = np.median(d, axis=0), np.median(np.abs(d), axis=0), np.median(s, axis=0)
        within = np.mean(np.abs(d) <= 3.0 * s + REFERENCE_ERROR_PX)
        wrong = np.mean(np.hypot(*d.T) > WRONG_PX)
        return (
            self.name, self.disparity.method, f"{100.0 * len(d) / self.points:.1f}", f"{middle[0]:+.3f} / {middle[1]:+.3f}",
            f"{size[0]:.3f} / {size[1]:.3f}", f"{100.0 * within:.1f}", f"{100.0 * wrong:.2f}", f"{sigma[0]:.3f} / {sigma[1]:.3f}",
            f"{self.neighbour_share:.2f}", f"{self.cpu_s:.1f}",
        )  # fmt: skip


def read(path: Path) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Read one image of the folder."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise SystemExit(f"{path}: cannot be read; give the folder of the real rasters.")
    return image.astype(np.uint16) if image.dtype == np.uint16 else image.astype(np.uint8)


def third_measure(first: Image, second: Image, x: float, y: float, u: float, v: float) -> tuple[float, float] | None:
    """Displacement of a block by the enhanced correlation coefficient, from a first value; None without convergence."""
    half, height, width = THIRD_BLOCK_PX // 2, *first.shape
    x0, top = round(x - half), round(y - half)
    if min(x0, top) < 0 or x0 + THIRD_BLOCK_PX > width or top + THIRD_BLOCK_PX > height:
        return None
    block = np.ascontiguousarray(first[top : top + THIRD_BLOCK_PX, x0 : x0 + THIRD_BLOCK_PX])
    start = np.array([[1.0, 0.0, x0 + u], [0.0, 1.0, top + v]], dtype=np.float32)
    everywhere = np.full(second.shape, 255, dtype=np.uint8)
    try:
        _, motion = cv2.findTransformECC(block, second, start, cv2.MOTION_AFFINE, THIRD_CRITERIA, everywhere, 1)
    except cv2.error as error:
        if error.code != cv2.Error.StsNoConv:
            raise
        return None
    to_x, to_y = motion @ np.array([x - x0, y - top, 1.0])
    return (to_x - x, to_y - y) if np.hypot(to_x - x - u, to_y - y - v) < THIRD_REACH_PX else None


def compare(table: Path, settings: DicSettings) -> Comparison:
    """Correlate one pair and compare the map with the reference table."""
    first, second = table.stem.split("__")
    images = [read(table.parent / f"{name}.png") for name in (first, second)]
    started = time.process_time()
    disparity = dic.match(images[0], images[1], settings=settings)
    cpu_s = time.process_time() - started
    reference = np.genfromtxt(table, delimiter=",", skip_header=1).reshape(-1, 5)
    x, y = disparity.grid.mesh()
    points, difference, sigma, blocks = 0, [], [], []
    first_grey, second_grey = (image.astype(np.float32) for image in images)
    for centre_x, centre_y, u, v, _ in reference:
        near = (np.abs(x - centre_x) <= BLOCK_DISTANCE_PX / 2) & (np.abs(y - centre_y) <= BLOCK_DISTANCE_PX / 2)
        points += int(np.count_nonzero(near))
        near &= disparity.valid
        difference.append(np.column_stack([disparity.u_px[near] - u, disparity.v_px[near] - v]))
        sigma.append(np.column_stack([disparity.sigma_u_px[near], disparity.sigma_v_px[near]]))
        third = third_measure(first_grey, second_grey, centre_x, centre_y, u, v) if near.any() else None
        if third is not None:
            blocks.append([(u, v), (disparity.u_px[near].mean(), disparity.v_px[near].mean()), third])
    share = disparity.neighbour_share
    median_share = 0.0 if share is None or not disparity.valid.any() else float(np.median(share[disparity.valid]))
    return Comparison(
        table.stem,
        disparity,
        cpu_s,
        max(points, 1),
        np.concatenate(difference),
        np.concatenate(sigma),
        median_share,
        np.array(blocks).reshape(-1, 3, 2),
    )


def lines(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """A table in Markdown."""
    return ["| " + " | ".join(cells) + " |" for cells in (columns, ("---",) * len(columns), *rows)]


def page(comparisons: list[Comparison], method: str, subset_areas: list[str]) -> str:
    """The validation page."""
    table = lines(COLUMNS, [c.row() for c in comparisons])
    third = lines(THIRD_COLUMNS, [c.third_row() for c in comparisons if len(c.blocks)])
    return "\n".join(
        [
            "# Validation with real rasters",
            "",
            "Pairs of frames of one place from scanning probe and electron microscopes, in which the texture is weak, rows have offsets",
            "and shifts of their own, and drift bends the field. The images belong to others and are not part of the code base.",
            "",
            "    python tests/benchmarks/bench_real_rasters.py FOLDER --write",
            "",
            f"Default settings (subset 43 px, step 5 px), method `{method}`. The reference is a table of blocks of 48 px found by",
            "normalised cross-correlation; only blocks are listed where grey levels and band-passed images agree within 0.5 px.",
            "",
            "| column | definition |",
            "|---|---|",
            "| area | points of the grid within 6 px of a reference block that converged |",
            "| median du / dv | median of measured minus reference displacement |",
            "| median magnitude | the same of the magnitude; it contains the scatter of the reference, 0.02 to 0.20 px |",
            "| within | differences of at most 3 stated sigma plus 0.3 px, the uncertainty of the reference |",
            "| wrong | points farther than 2 px from the reference |",
            "| neighbour share | median part of a value from neighbours and smoothness instead of the point's subset |",
            "",
            *table,
            "",
            f"With the method `subset` the areas are {', '.join(subset_areas)} % (same order, same command with",
            "`--method subset`).",
            "",
            "## Reference and third measure",
            "",
            "The reference is a measurement, too. A third one is the enhanced correlation coefficient (OpenCV `findTransformECC`, after",
            "Evangelidis and Psarakis 2008, [doi:10.1109/TPAMI.2008.113](https://doi.org/10.1109/TPAMI.2008.113)): affine motion of",
            f"blocks of {THIRD_BLOCK_PX} px of the grey levels as read, with sub-pixel interpolation, started from the reference. It",
            "shares no code with semlive or the reference, which takes blocks as rigid and interpolates the peak with a parabola.",
            "*Measured* is the mean of the map within 6 px of the block, *wrong* a block whose mean is farther than 2 px from the",
            "reference.",
            "",
            *third,
            "",
            "A reference block is a mean over 48 rows. For frames rendered from the measured fields themselves, the same",
            "reference program differs from the known displacement by a median of up to 0.14 px (PMN28Pt), 0.38 px (PZT_final)",
            "and 0.52 px (approx5050compos).",
            "How the method works: [correlation](../explanations/correlation.md#global-method-for-rasters).",
            "",
        ]
    )


def main() -> None:
    """Compare all pairs of a folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=[], help="parts of the names of pairs")
    parser.add_argument("--method", choices=("auto", "subset", "global"), default="auto")
    parser.add_argument("--write", action="store_true", help="write docs/validation/real-rasters.md")
    given = parser.parse_args()
    tables = [path for path in sorted(given.folder.glob("*__*.csv")) if not given.only or any(part in path.stem for part in given.only)]
    if not tables:
        raise SystemExit(f"{given.folder}: has no table FIRST__SECOND.csv; give the folder of the real rasters.")
    settings = DicSettings(roi_px=None, method=given.method)
    comparisons = []
    sys.stdout.write(" | ".join(COLUMNS) + "\n" + " | ".join(THIRD_COLUMNS) + "\n")
    for table in tables:
        comparisons.append(compare(table, settings))
        sys.stdout.write(" | ".join(comparisons[-1].row()) + "\n")
        if len(comparisons[-1].blocks):
            sys.stdout.write("third: " + " | ".join(comparisons[-1].third_row()) + "\n")
        sys.stdout.flush()
    if given.write:
        areas = [compare(table, DicSettings(roi_px=None, method="subset")).row()[2] for table in tables]
        PAGE.write_text(page(comparisons, given.method, areas), encoding="utf-8")


if __name__ == "__main__":
    main()
