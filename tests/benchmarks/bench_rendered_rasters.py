"""Hard rasters with known truth: ``python tests/benchmarks/bench_rendered_rasters.py [--write] [--each]``.

Six natural textures with thirteen disturbances: rows that shift and jump, rows of other brightness and gain, charging, another detector,
weak contrast, shot noise, clipping. `rasters/matchable.py` defines what is matchable, `rasters/judge.py` what is wrong. The bars are 95 %
of the matchable points of every disturbance, and no wrong point. The scenes and their truth take 60 s of processor time; the rest is the
correlation with its default settings. `--write` puts the table into docs/validation/correlation.md.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from paper import write_between
from rasters.judge import Count, count, judge
from rasters.scenes import NAMES, scene

from semlive import dic
from semlive.data.settings import DicSettings

MIN_SHARE = 0.95
SETTINGS = DicSettings(roi_px=None)
PAGE = Path(__file__).parents[2] / "docs" / "validation" / "correlation.md"
HEADINGS = (
    "disturbance",
    "points",
    "matchable",
    "of these measured %",
    "wrong",
    "largest error px",
    "rms error px",
    "rms of error / sigma",
    "within 1 / 1.96 / 3 sigma %",
)


def measure(number: int, settings: DicSettings = SETTINGS) -> Count:
    """Render a scene, correlate it and count."""
    s = scene(number)
    m = dic.match(s.first, s.second, settings=settings)
    return count(m, judge(s, m))


def row(name: str, c: Count) -> str:
    """One line of the table."""
    values = max(2 * c.matched, 1)
    within = " / ".join(f"{100 * n / values:.0f}" for n in (c.within_1, c.within_2, c.within_3))
    ratio = (c.normalised / values) ** 0.5
    measured = f"{c.points} | {c.matchable} | {100 * c.share:.1f} | {c.wrong}"
    return f"| {name} | {measured} | {c.worst_px:.2f} | {c.rms_px:.3f} | {ratio:.2f} | {within} |"


def table(counts: dict[tuple[str, str], Count]) -> str:
    """By disturbance, by texture, and all."""
    by: dict[str, Count] = defaultdict(Count)
    for (texture, disturbance), c in counts.items():
        by[disturbance] += c
        by[f"*{texture}*"] += c
    ordered = sorted(by, key=lambda name: name.startswith("*"))
    lines = [f"| {' | '.join(HEADINGS)} |", "|" + "---|" * len(HEADINGS), *(row(name, by[name]) for name in ordered)]
    total = sum(counts.values(), Count())
    reached = sum(c.share >= MIN_SHARE for name, c in by.items() if not name.startswith("*"))
    lines += [
        row("all", total),
        "",
        f"{reached} of {len(set(d for _, d in counts))} disturbances reach {100 * MIN_SHARE:.0f} % of the matchable points.",
    ]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help=f"number of the first scene; from {len(NAMES)} on the surfaces are others")
    parser.add_argument("--count", type=int, default=len(NAMES), help="number of scenes")
    parser.add_argument("--only", nargs="+", default=[], help="parts of names of textures or disturbances")
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    parser.add_argument("--each", action="store_true", help="print every scene")
    parser.add_argument("--write", action="store_true", help="put the table into docs/validation/correlation.md")
    given = parser.parse_args(arguments)
    counts: dict[tuple[str, str], Count] = defaultdict(Count)
    numbers = [
        number
        for number in range(given.first, given.first + given.count)
        if not given.only or any(part in " ".join(NAMES[number % len(NAMES)]) for part in given.only)
    ]
    with ProcessPoolExecutor(given.jobs) as pool:
        for number, found in zip(numbers, pool.map(measure, numbers), strict=True):
            key = NAMES[number % len(NAMES)]
            counts[key] += found
            if given.each:
                sys.stdout.write(row(", ".join(key), found) + "\n")
                sys.stdout.flush()
    text = table(counts)
    sys.stdout.write(text + "\n")
    if given.write:
        PAGE.write_text(write_between(PAGE.read_text(encoding="utf-8"), "rendered rasters", text), encoding="utf-8")


if __name__ == "__main__":
    main()
