"""Displacement of one pair of scans by each of its channels: ``python tests/benchmarks/bench_scan_channels.py FOLDER FIRST:SECOND ...``.

A scanning microscope records several channels of one scan at the same time (height, phase, amplitude, deflection). They show different
textures at the same places, so the displacement from one scan to the next is one field whichever channel shows it. Maps from different
channels share no grey level: where two of them converged, their difference is an error of at least one.

FOLDER holds SCAN.CHANNEL.png with the rows of all scans in one order. For each pair of scans every channel that both have is correlated
with default settings, and all maps are compared with each other. ``--write`` writes docs/validation/scan-channels.md.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[2]))

from bench_real_rasters import read

from semlive import dic
from semlive.data.disparity import DisparityMap
from semlive.data.settings import DicSettings

WRONG_PX = 2.0
MIN_POINTS = 50  # that two maps must share
PAGE = Path(__file__).parents[2] / "docs" / "validation" / "scan-channels.md"
MAP_COLUMNS = ("scans", "channel", "method", "converged %", "median sigma u / v px")
COLUMNS = (
    "scans", "channels", "points", "median difference u / v px", "median magnitude u / v px", "largest distance px", "within 3 sigma %",
    "wrong points",
)  # fmt: skip


def read_channels(folder: Path, first: str, second: str) -> dict[str, DisparityMap]:
    """Correlate every channel that both scans have."""
    maps = {}
    for path in sorted(folder.glob(f"{first}.*.png")):
        channel = path.name.removeprefix(f"{first}.").removesuffix(".png")
        other = folder / f"{second}.{channel}.png"
        if other.exists():
            maps[channel] = dic.match(read(path), read(other), settings=DicSettings(roi_px=None))
    return maps


def map_row(scans: str, channel: str, found: DisparityMap) -> tuple[str, ...]:
    """Cells of the table of maps, as `MAP_COLUMNS`."""
    valid = found.valid
    sigma = [f"{np.median(values[valid]):.3f}" if valid.any() else "-" for values in (found.sigma_u_px, found.sigma_v_px)]
    return scans, channel, found.method, f"{100.0 * valid.mean():.1f}", " / ".join(sigma)


def difference_row(scans: str, channels: tuple[str, str], one: DisparityMap, other: DisparityMap) -> tuple[str, ...] | None:
    """Cells of the table of differences, as `COLUMNS`; None where the maps share too few points."""
    both = one.valid & other.valid
    if np.count_nonzero(both) < MIN_POINTS:
        return None
    difference = np.stack([one.u_px - other.u_px, one.v_px - other.v_px])[:, both]
    sigma = np.stack([np.hypot(one.sigma_u_px, other.sigma_u_px), np.hypot(one.sigma_v_px, other.sigma_v_px)])[:, both]
    middle, size = np.median(difference, axis=1), np.median(np.abs(difference), axis=1)
    distance = np.hypot(*difference)
    return (
        scans, ", ".join(channels), str(difference.shape[1]), f"{middle[0]:+.3f} / {middle[1]:+.3f}", f"{size[0]:.3f} / {size[1]:.3f}",
        f"{distance.max():.2f}", f"{100.0 * np.mean(np.abs(difference) <= 3.0 * sigma):.1f}", str(np.count_nonzero(distance > WRONG_PX)),
    )  # fmt: skip


def table(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """A table in Markdown."""
    return ["| " + " | ".join(cells) + " |" for cells in (columns, ("---",) * len(columns), *rows)]


def page(maps: list[tuple[str, ...]], differences: list[tuple[str, ...]]) -> str:
    """The validation page."""
    points, wrong = (sum(int(row[k]) for row in differences) for k in (2, 7))
    return "\n".join(
        [
            "# Validation with several channels of one scan",
            "",
            "An atomic force microscope records several channels of a scan at the same time: height, phase, amplitude, deflection.",
            "They show different textures at the same places, so the displacement from one scan to the next is one field. Maps from",
            "different channels share no grey level: where both converged, a difference is an error of at least one of them.",
            "",
            "    python tests/benchmarks/bench_scan_channels.py FOLDER FIRST:SECOND ... --write",
            "",
            "Default settings. The scans are those of [real rasters](real-rasters.md) and further ones of the same repositories",
            "(pycroscopy/DTMicroscope at commit 17245ba6, colinedsall/ofdspm at c4eff7fb); their images belong to others and are not",
            "part of the code base. Grey levels from the 0.1 % to the 99.9 % percentile; rows in one order.",
            "",
            "A map without a point is a refusal with its reason: the channel has no texture, or noise alone.",
            "",
            *table(MAP_COLUMNS, maps),
            "",
            f"Differences of two maps where both converged: {points} points, {wrong} of them wrong (farther than {WRONG_PX:g} px from",
            "each other).",
            "",
            *table(COLUMNS, differences),
            "",
            "The maps of approx5050compos that differ by more than 2 px lie in one corner, where each states 0.6 to 1.0 px. In PZT_final",
            "the piezoresponse (amplitude, phase) agrees with itself and the surface (deflection, height) with itself, but the two differ",
            "by up to 1.2 px, more than stated. Ferroelectric domains can move against the surface; whether they did is not known.",
            "",
        ]
    )


def main() -> None:
    """Compare the channels of all pairs of scans."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("scans", nargs="+", metavar="FIRST:SECOND")
    parser.add_argument("--write", action="store_true", help="write docs/validation/scan-channels.md")
    given = parser.parse_args()
    map_rows, rows = [], []
    for scans in given.scans:
        first, _, second = scans.partition(":")
        maps = read_channels(given.folder, first, second)
        if not maps:
            raise SystemExit(f"{given.folder}: has no channel SCAN.CHANNEL.png that {first} and {second} share.")
        map_rows += [map_row(scans, channel, found) for channel, found in maps.items()]
        pairs = itertools.combinations(maps, 2)
        rows += [row for pair in pairs if (row := difference_row(scans, pair, maps[pair[0]], maps[pair[1]])) is not None]
    sys.stdout.write("\n".join([*table(MAP_COLUMNS, map_rows), *table(COLUMNS, rows)]) + "\n")
    if given.write:
        PAGE.write_text(page(map_rows, rows), encoding="utf-8")


if __name__ == "__main__":
    main()
