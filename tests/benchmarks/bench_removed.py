"""Effects removed from the dictionary that are not UNKNOWN: is the residual of what is identified instead larger than that of the truth?

    python tests/benchmarks/bench_removed.py [--seeds 3] [--folder tests/benchmarks/blind/final] [--write]

The cases are those of bench_diagnose.py --removed whose verdict in the folder is not UNKNOWN. Each is diagnosed again without the true
effect in the dictionary, and the true effect with its own parameters is fitted to the same data. The squared norms of the whitened
residuals of both fits are compared. A test of the residual can only detect an excess of the first over the second that is large compared
with the standard deviation of such a norm, the root of twice the number of values.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from bench_diagnose import verdicts, write
from blind.cases import REMOVED, Case, Counts, cases
from blind.hiding import DETECTABLE_PX

from semlive.data.diagnosis.effects import ModelEffect
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.diagnose.baseline.model_effects import add_model_effects
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.maps.relinearise import choose_coupling
from semlive.diagnose.maps.verdict import diagnose

FINAL = Path(__file__).parent / "blind" / "final"
PART = "removed"
HEAD = "| removed effect | outcome | instead | squared residual | with the true effect | excess, standard deviations |"


def main() -> None:
    """Compare the residuals of every such case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", choices=("development", "final"), default="final")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--folder", type=Path, default=FINAL, help="verdicts of bench_diagnose.py")
    parser.add_argument("--most", type=int, default=None, help="number of cases")
    parser.add_argument("--write", action="store_true", help="put the table into docs/validation/diagnosis.md")
    arguments = parser.parse_args()
    before = verdicts(arguments.folder)
    listed = cases(arguments.set, Counts(0, removed=arguments.seeds), [], list(DETECTABLE_PX))
    chosen = [case for case in listed if case.kind == REMOVED and before.get(case.key, {}).get("outcome") != "UNKNOWN"]
    lines, within = [HEAD, "|---" * 6 + "|"], 0
    for case in chosen[: arguments.most]:
        line, excess = compared(case)
        within += excess < 1.0
        lines.append(line)
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()
    count = len(lines) - 2
    summary = f"{within} of {count} have no residual that exceeds that of the true effect by one standard deviation"
    sys.stdout.write(f"{summary}\n")
    if arguments.write:
        write("\n".join(lines) + "\n", summary, PART)


def compared(case: Case) -> tuple[str, float]:
    """A line of the table, and the excess of the residual in standard deviations."""
    observation = case.observed()
    found = diagnose(observation, dictionary=case.dictionary())
    true = [effect for effect in diagnose(observation).effects if effect.name in case.names]
    instead = squared_residual(observation, [effect.model_effect for effect in found.effects])
    truth = squared_residual(observation, [effect.model_effect for effect in true])
    excess = (instead - truth) / np.sqrt(2.0 * observation.disparity_px.size)
    return f"| `{case.names[0]}` | {found.outcome.value} | {_instead(found)} | {instead:.0f} | {truth:.0f} | {excess:.2f} |", float(excess)


def squared_residual(observation: Observation, effects: Sequence[ModelEffect]) -> float:
    """Squared norm of the whitened residual of the most likely fit with the effects, in units of the noise."""
    baseline = noise_scaled_baseline(choose_coupling(observation, (), effects).observation)
    return float(np.sum(add_model_effects(baseline, effects)[0].residual() ** 2))


def _instead(found: Diagnosis) -> str:
    names = found.ambiguous or [effect.name for effect in found.effects] or list(found.coarse) or ["drift"]
    return ", ".join(f"`{name}`" for name in names)


if __name__ == "__main__":
    main()
