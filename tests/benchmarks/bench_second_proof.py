"""Confirmation of a diagnosis by simulation, from images on: a run with a hidden effect is diagnosed with `semlive diagnose --prove`.

    python tests/benchmarks/bench_second_proof.py [--scenario short] [--effect magnification_drift] [--out FOLDER]

Three runs through the daemon: one of a scenario with the effect hidden in it, which is diagnosed, and the two simulations of the command,
without and with the effects found, with another seed. Prints one JSON object; the exit code is 1 if the effect was not named or the
simulation does not confirm it. A run of the short scenario takes about a minute and a half.
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
SEED = 41


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
        reported = confirmation(requests.scenario, requests.effect, folder)
    sys.stdout.write(json.dumps(reported) + "\n")
    named = [item["name"] for item in reported["diagnosis"]["effects"]]
    return int(requests.effect not in named or not reported["diagnosis"]["proof"]["confirmed"])


def confirmation(scenario: str, effect: str, folder: Path) -> dict[str, Any]:
    """Return the hidden effect and the result of the command."""
    measured = folder / "measured.yaml"
    measured.write_text(yaml.safe_dump({"extends": scenario, "seed": SEED, "effects": {effect: HIDDEN[effect]}}), encoding="utf-8")
    log = _run(measured, folder / "measured")
    printed = _semlive("diagnose", str(log), "--prove", scenario, "--prove-out", str(folder / "prove"), "--json")
    return {"hidden": {effect: HIDDEN[effect]}, "diagnosis": json.loads(printed)}


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
