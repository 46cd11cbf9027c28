"""Time and peak memory of a verdict: 15, 40 and 500 pairs, 15 pairs with dense points, and 15 pairs with three effects.

    python tests/benchmarks/bench_verdict_cost.py [--cases "15 pairs" ...] [--folder cost] [--write]
    python tests/benchmarks/bench_verdict_cost.py --score [--write]

All runs are imported without a hint about the subset, from a generator that shares no code with semlive (tests/benchmarks/foreign). Each
command runs in a process of its own; time and memory are those that the system counts for it. Limits: 60 s on two cores and 2 GB for a
verdict of 15 pairs; the cost of more pairs is at most linear.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from foreign.effects import Hidden, Spot, changing_raster, charged_spots, together
from foreign.noise import SHAPES
from foreign.world import Raster, Series, write

PAGE = Path(__file__).parents[2] / "docs" / "validation" / "diagnosis.md"
BEGIN, END = "<!-- verdict cost: begin -->\n", "<!-- verdict cost: end -->\n"
MAX_SECONDS, MAX_GB = 60.0, 2.0


@dataclass(frozen=True, slots=True)
class CostCase:
    """A run of so many pairs, on points so many px apart, with or without three effects."""

    calibration: int
    tension: int
    step_px: int
    raster: tuple[int, int] = (1024, 884)
    effects: bool = False


CASES = {
    "15 pairs": CostCase(8, 7, 16),
    "15 pairs, dense points": CostCase(8, 7, 5),
    "15 pairs, three effects": CostCase(8, 7, 16, effects=True),
    "40 pairs": CostCase(20, 20, 16),
    "500 pairs": CostCase(250, 250, 16, (480, 414)),
    "smoke": CostCase(3, 2, 48, (640, 552)),
}
SPOTS = (Spot(300.0, 250.0, 60.0, 0.15, 0.2), Spot(750.0, 600.0, 120.0, 0.15, 0.5))


def measured(case: CostCase) -> dict[str, Any]:
    """Processor time, elapsed time and peak memory of import and verdict, and the outcome."""
    with tempfile.TemporaryDirectory() as name:
        folder, log = Path(name) / "maps", Path(name) / "maps.mcap"
        raster = Raster(width=case.raster[0], height=case.raster[1], step_px=case.step_px, margin_px=case.raster[0] // 12)
        series = Series(1, case.calibration, case.tension, raster=raster)
        write(series, SHAPES["gaussian"], folder, three_effects(series.end_s) if case.effects else None)
        imported = _command("import", str(folder), "-o", str(log))
        verdict = _command("diagnose", str(log), "--json")
    outcome = json.loads(verdict.pop("output"))
    imported.pop("output")
    names = [effect["name"] for effect in outcome["effects"]]
    return {"import": imported, "verdict": verdict, "outcome": ", ".join([outcome["outcome"], *names]), "pairs": outcome["pairs"]}


def three_effects(end_s: float) -> Hidden:
    """A magnification that changes, a raster that rotates, and charged spots of two widths."""
    return together(changing_raster(3e-4, 2e-4, end_s), charged_spots(SPOTS, end_s))


def _command(*arguments: str) -> dict[str, Any]:
    """Run a command of semlive; the figures of its process and those it started."""
    with tempfile.TemporaryFile() as output:
        begin = time.monotonic()
        process = subprocess.Popen([sys.executable, "-m", "semlive", *arguments], stdout=output)
        _, status, usage = os.wait4(process.pid, 0)
        elapsed_s = time.monotonic() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        text = output.read().decode()
    if process.returncode:
        raise RuntimeError(f"semlive {arguments[0]} ended with {process.returncode}")
    return {"cpu_s": usage.ru_utime + usage.ru_stime, "elapsed_s": elapsed_s, "gb": usage.ru_maxrss / 1e6, "output": text}


def table(results: dict[str, dict[str, Any]]) -> str:
    """Markdown table of the cases."""
    heads = ["run", "pairs used", "outcome", "import: CPU, s", "GB", "verdict: CPU, s", "elapsed, s", "GB", ""]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, result in results.items():
        imported, verdict, pairs = result["import"], result["verdict"], result["pairs"]
        met = "met" if verdict["gb"] <= MAX_GB and min(verdict["elapsed_s"], verdict["cpu_s"]) <= MAX_SECONDS else "missed"
        lines.append(
            f"| {name} | {pairs['used']} of {pairs['of']} | {result['outcome']} | {imported['cpu_s']:.0f} | {imported['gb']:.2f} | "
            f"{verdict['cpu_s']:.0f} | {verdict['elapsed_s']:.0f} | {verdict['gb']:.2f} | {met} |"
        )
    return "\n".join([*lines, ""])


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="*", default=[name for name in CASES if name != "smoke"], choices=list(CASES))
    parser.add_argument("--folder", type=Path, default=Path("cost"))
    parser.add_argument("--score", action="store_true", help="measure nothing")
    parser.add_argument("--write", action="store_true", help="put the table into docs/validation/diagnosis.md")
    requests = parser.parse_args()
    requests.folder.mkdir(parents=True, exist_ok=True)
    results: dict[str, dict[str, Any]] = {}
    for name in requests.cases:
        path = requests.folder / f"{name.replace(', ', '-').replace(' ', '-')}.json"
        if not path.exists() and not requests.score:
            path.write_text(json.dumps(measured(CASES[name])), encoding="utf-8")
        if path.exists():
            results[name] = json.loads(path.read_text(encoding="utf-8"))
    found = table(results)
    sys.stdout.write(found)
    if requests.write:
        before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}\n{found}\n{END}{rest.split(END)[1]}", encoding="utf-8")


if __name__ == "__main__":
    main()
