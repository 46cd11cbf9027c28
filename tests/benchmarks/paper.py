"""The paper's experiments side by side with its figures: ``python tests/benchmarks/paper.py --scenario paper_x200 --out DIR``.

Runs the complete experiment through the daemon (or takes a run folder that is already in DIR), compares it with truth and with the
paper, prints the table, and writes it with its figure into docs/validation/. About 4 minutes on two cores at x200.
``--seeds 2 3`` plays it again with other seeds and writes their results, next to the scenario's own, into a separate table.
``--quick`` plays few pairs and does not change the docs. A daemon's first start compiles for up to 80 s, which at rate 40 are 53
minutes in which the drift comes to rest (5.3 px across the first image were 1 px): play a short demo first.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import yaml
from sidebyside.facts import CURVE_WINDOWS, PAPER, QUICK_WINDOWS, WIDER_WINDOWS, PaperFigures
from sidebyside.figure import curve_svg
from sidebyside.measure import RunFigures, measure
from sidebyside.seeds import seed_rows, seeds_markdown
from sidebyside.table import curve_markdown, markdown, rows

from semlive.errors import BadInput

DOCS = Path(__file__).resolve().parents[2] / "docs" / "validation"
QUICK = {
    "calibration_shifts_px": [[0, 0], [12, 0], [-12, 0], [0, 12], [0, -12]],
    "translation_shifts_px": [],
    "loads_n": [100, 800, 1500, 2200],
}


def run_demo(scenario: str, folder: Path, rate: float, *, quick: bool, seed: int | None = None) -> None:
    """Play a scenario through the daemon."""
    name = scenario
    changes = {"experiment": {"protocol": QUICK, "limits": {"force_step_max_n": 2200}}} if quick else {}
    if seed is not None:
        changes["seed"] = seed
    if changes:
        folder.parent.mkdir(parents=True, exist_ok=True)
        path = folder.parent / f"{folder.name}.yaml"
        path.write_text(yaml.safe_dump({"extends": scenario, **changes}), encoding="utf-8")
        name = str(path)
    command = [sys.executable, "-m", "semlive", "demo", "--scenario", name, "--out", str(folder), "--rate", str(rate)]
    subprocess.run(command, check=True)


def section(figures: RunFigures, paper: PaperFigures, scenario: str) -> str:
    """The text between a scenario's markers."""
    printed = f"{figures.frames} frames, {figures.points} points in each. The gauge is (points - 1) × step + subset."
    return "\n\n".join(
        (
            markdown(figures, paper),
            printed,
            f"![Scatter of displacement and strain against gauge length, {paper.title}]({scenario.replace('_', '-')}.svg)",
            "All frames and components together, root mean square:",
            curve_markdown(figures),
        )
    )


def write_between(text: str, part: str, new: str) -> str:
    """The document with the text between a part's markers replaced.

    Raises:
        BadInput: its markers are missing.
    """
    begin, end = f"<!-- {part}: begin -->", f"<!-- {part}: end -->"
    before, found, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise BadInput(f"docs/validation/paper.md: lacks {begin} or {end}; put both back")
    return f"{before}{begin}\n{new}\n{end}{after}"


def main() -> int:
    """Run, measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenario", choices=list(PAPER), default="paper_x200")
    parser.add_argument("--out", type=Path, required=True, help="folder for the run and the results; a run that is already in it is taken")
    parser.add_argument("--rate", type=float, default=40.0, help="seconds of experiment per second of wall time")
    parser.add_argument("--quick", action="store_true", help="few pairs and gauge lengths; the docs stay as they are")
    parser.add_argument("--seeds", type=int, nargs="+", default=[], help="play it with these seeds too")
    parser.add_argument("--no-docs", action="store_true", help="leave the docs as they are")
    options = parser.parse_args()
    scenario, paper, out = options.scenario, PAPER[options.scenario], options.out.resolve()
    windows = QUICK_WINDOWS if options.quick else (*CURVE_WINDOWS, *WIDER_WINDOWS)
    run = out if (out / "log" / "demo").is_dir() else out / "run"
    runs = {"own": run, **{str(seed): run.with_name(f"{run.name}-{seed}") for seed in options.seeds}}
    for seed, folder in runs.items():
        if not (folder / "log" / "demo").is_dir():
            run_demo(scenario, folder, options.rate, quick=options.quick, seed=None if seed == "own" else int(seed))
    found = tuple(measure(folder, windows) for folder in runs.values())
    table, svg, text = rows(found[0], paper), curve_svg(found[0], paper), section(found[0], paper, scenario)
    seeds = seeds_markdown(tuple(runs), found) if options.seeds else ""
    sys.stdout.write(f"{text}\n\n{seeds}\n")
    (out / f"{scenario}.md").write_text(text + "\n", encoding="utf-8")
    (out / f"{scenario}.svg").write_text(svg, encoding="utf-8")
    (out / f"{scenario}.json").write_text(json.dumps([vars(row) for row in table], indent=1), encoding="utf-8")
    if not (options.quick or options.no_docs):
        write_docs(scenario, text, svg, seeds)
    missed = [row.quantity for row in (*table, *(seed_rows(found) if options.seeds else ())) if row.held is False]
    for quantity in missed:
        sys.stdout.write(f"bar missed: {quantity}\n")
    return 1 if missed else 0


def write_docs(scenario: str, text: str, svg: str, seeds: str) -> None:
    """Put the results of a run, and of its seeds if there are any, into the page."""
    page = DOCS / "paper.md"
    reported = write_between(page.read_text(encoding="utf-8"), scenario, text)
    page.write_text(write_between(reported, f"{scenario}_seeds", seeds) if seeds else reported, encoding="utf-8")
    (DOCS / f"{scenario.replace('_', '-')}.svg").write_text(svg, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
