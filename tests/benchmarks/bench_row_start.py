"""Law of the settling at the start of rows of a real multi-beam microscope, from its four tables.

    python tests/benchmarks/bench_row_start.py --tables FOLDER [--write]

The tables of templiert/scan_correction (commit 5f3a6285, GPL-3; not part of this repository) hold an exponential for each of 61 beams
at two pixel sizes and two dwell times. A profile is the median over the beams; its uncertainty is that of the median. Each table is
also predicted by each law from the three others.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from semlive.diagnose.row_start.laws import RowStartLaw, log_evidence, row_start_law
from semlive.diagnose.row_start.profile import RowStartProfile, fit_profile

PAGE = Path(__file__).parents[2] / "docs" / "validation" / "diagnosis.md"
BEGIN, END = "<!-- row start: begin -->\n", "<!-- row start: end -->\n"
TABLES = {"4nm_400ns": (4.0, 4e-7), "4nm_1600ns": (4.0, 1.6e-6), "8nm_400ns": (8.0, 4e-7), "8nm_1600ns": (8.0, 1.6e-6)}
DISTANCE_PX = np.geomspace(1.0, 1500.0, 60)


def main() -> None:
    """Print, or write, the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=Path, required=True)
    parser.add_argument("--write", action="store_true", help="put the table into docs/validation/diagnosis.md")
    arguments = parser.parse_args()
    found = table([profile_of(arguments.tables / f"{name}.txt", *setting) for name, setting in TABLES.items()])
    sys.stdout.write(found)
    if arguments.write:
        page = PAGE.read_text(encoding="utf-8")
        before, rest = page.split(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}\n{found}\n{END}{rest.split(END)[1]}", encoding="utf-8")


def profile_of(path: Path, pixel_nm: float, pixel_s: float) -> RowStartProfile:
    """Median profile of the beams of a table."""
    lines = [line.split("\t") for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    a, b, c = np.array([[float(cells[place]) for place in (3, 5, 7)] for cells in lines]).T[..., None]
    beams = a * np.exp(-b * DISTANCE_PX) + c
    median = np.median(beams, axis=0)
    spread = 1.4826 * np.median(np.abs(beams - median), axis=0)
    return RowStartProfile(pixel_nm, pixel_s, DISTANCE_PX, median, 1.2533 * spread / np.sqrt(len(beams)) + 1e-3)


def table(profiles: list[RowStartProfile]) -> str:
    """Log evidence of each law for each table given the others, and for all."""
    fits = [fit for profile in profiles if (fit := fit_profile(profile, 1)) is not None]
    heads = ["table", "amplitude", "length", *RowStartLaw]
    rows = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    whole = {law: log_evidence(fits, law) for law in RowStartLaw}
    right = 0
    for place, (name, fit) in enumerate(zip(TABLES, fits, strict=True)):
        others = [value for at, value in enumerate(fits) if at != place]
        odds = {law: whole[law] - log_evidence(others, law) for law in RowStartLaw}
        right += max(odds, key=lambda law: odds[law]) is RowStartLaw.POSITION
        cells = [f"{odds[law]:.1f}" for law in RowStartLaw]
        rows.append(f"| {name} | {fit.amplitude_px[0]:.2f} px | {fit.length_px[0]:.0f} px | {' | '.join(cells)} |")
    rows.append(f"| all | | | {' | '.join(f'{whole[law]:.1f}' for law in RowStartLaw)} |")
    verdict, one = row_start_law(profiles), row_start_law(profiles[:1])
    best = one.experiments[0]
    return "\n".join(
        [
            *rows,
            "",
            f"All four: {verdict.outcome}, {', '.join(verdict.laws)}, {verdict.amplitudes[0]:.1f} nm over {verdict.constants[0]:.0f} nm, "
            f"scatter {100 * verdict.scatter:.0f} %.",
            f"Most likely law of a table given the three others: position in {right} of {len(fits)}.",
            f"From the first table alone: {one.outcome}; proposed are pixels of {best.setting.pixel_nm:g} nm at "
            f"{best.setting.pixel_s * 1e9:.0f} ns, with expected log odds of {best.log_odds:.1f}.",
            "",
        ]
    )


if __name__ == "__main__":
    main()
