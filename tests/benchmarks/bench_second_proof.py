"""The second proof, from images on: a hidden effect is found in a run, simulated from its model, and run through the daemon again.

    python tests/benchmarks/bench_second_proof.py [--scenario short] [--effect magnification_drift] [--out FOLDER]

Three runs through the daemon: one of a scenario with the effect hidden in it, which is diagnosed; one of the scenario alone and one of
the scenario that `semlive simulate --from` makes of the model, both with another seed. `semlive experiment compare` says whether the gap
between measured and simulated maps shrinks. Prints one JSON object; the exit code is 1 if the effect was not named or the proof fails.
A run of the short scenario takes about a minute and a half.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import yaml

HIDDEN: dict[str, dict[str, Any]] = {
    "magnification_drift": {"change": 1.6e-3, "time_constant_s": 1800.0},
    "raster_rotation_drift": {"change_rad": 1.6e-3, "time_constant_s": 1800.0},
    "tilt_with_load": {"tilt_rad_per_n": 4.0e-6, "working_distance_mm": 14.1},
}
SEEDS = 41, 42


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="short")
    parser.add_argument("--effect", choices=list(HIDDEN), default="magnification_drift")
    parser.add_argument("--out", type=Path, default=None, help="where the runs stay; else they are deleted")
    requests = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = requests.out or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        reported = proved(requests.scenario, requests.effect, folder)
    sys.stdout.write(json.dumps(reported) + "\n")
    named = [item["name"] for item in reported["diagnosis"]["effects"]]
    return int(requests.effect not in named or not reported["comparison"]["confirmed"])


def proved(scenario: str, effect: str, folder: Path) -> dict[str, Any]:
    """What the diagnosis of the measured run says, and the comparison with both simulations."""
    measured = _scenario(folder / "measured.yaml", {"extends": scenario, "seed": SEEDS[0], "effects": {effect: HIDDEN[effect]}})
    without = _scenario(folder / "without.yaml", {"extends": scenario, "seed": SEEDS[1]})
    log = _run(measured, folder / "measured")
    diagnosis = json.loads(_semlive("diagnose", str(log), "-o", str(folder / "model.json"), "--json"))
    _semlive("simulate", str(without), "--out", str(folder / "played"), "--frames", "0", "--from", str(folder / "model.json"))
    with_effects = folder / "played" / "scenario.yaml"
    logs = [log, _run(without, folder / "without"), _run(with_effects, folder / "having")]
    comparison = json.loads(_semlive("experiment", "compare", *(str(item) for item in logs), "--json"))
    return {"hidden": {effect: HIDDEN[effect]}, "diagnosis": diagnosis, "comparison": comparison}


def _scenario(path: Path, content: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def _run(scenario: Path, folder: Path) -> Path:
    _semlive("demo", "--scenario", str(scenario), "--out", str(folder))
    return folder / "log" / "demo"


def _semlive(*arguments: str) -> str:
    done = subprocess.run([sys.executable, "-m", "semlive", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"semlive {' '.join(arguments)}: {done.stderr[-2000:]}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
