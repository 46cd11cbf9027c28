"""What the benchmark's experiments show of each effect, by the definition of the frozen sizes.

    python tests/benchmarks/bench_detectable.py [--seeds 8]

The least peak in the maps that is detected with 90 % power at 1 % false alarms over 26 families (effects.md, section 3): the noncentral
chi-squared of the residual of the effect after the fit of a smooth drift and distortion, in units of the noise. The effect is the
simulators' own, without noise, on the points of the benchmark; its law's grid and amplitudes count as tries. No verdict is made.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from blind.cases import GRID, ONE, Case
from blind.experiment import Conditions
from blind.hiding import DETECTABLE_PX
from blind.observing import observed
from numexp.noise import NoiseKind
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.bayes_factor import residual_gram
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline

FAMILIES, FALSE, POWER = 26, 0.01, 0.9
TRIED = 2.0
"""Times the frozen size: as large as a case that the baseline's linearisation holds for."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--effects", nargs="*", default=list(DETECTABLE_PX))
    requests = parser.parse_args()
    found: dict[str, list[float]] = {name: [] for name in requests.effects}
    for seed in range(1, requests.seeds + 1):
        baseline = noise_scaled_baseline(observed(Conditions(seed), (), GRID))
        alone = _noiseless(Conditions(seed), ())
        for name in requests.effects:
            case = Case(ONE, (name,), TRIED, seed)
            moved = _noiseless(case.conditions(), case.effects()) - alone
            found[name].append(least_px(baseline, name, moved))
    sys.stdout.write("| effect | frozen, px | by its definition here: median, least, largest |\n|---|---|---|\n")
    for name, sizes in found.items():
        sys.stdout.write(f"| `{name}` | {DETECTABLE_PX[name]:g} | {np.median(sizes):.4f}, {min(sizes):.4f}, {max(sizes):.4f} |\n")


def _noiseless(conditions: Conditions, effects: tuple) -> np.ndarray:  # type: ignore[type-arg]
    noiseless = replace(conditions, kind=NoiseKind.NONE, missing=0.0, outliers=0.0)
    return observed(noiseless, effects, GRID).disparity_px


def least_px(baseline: HyperparameterGrid, name: str, moved: np.ndarray) -> float:  # type: ignore[type-arg]
    """The peak at which what (f, b, 2) an effect moves is detected."""
    observation = baseline.design.observation
    reported = residual_gram(baseline, moved[..., None])[0, 0]
    family = effect_class(name)
    laws = [law for values in family.grid(observation.geometry) if (law := family.basis_field(observation.geometry, values)) is not None]
    amplitudes = laws[0].field_px.shape[-1]
    limit = chi2.isf(FALSE / (FAMILIES * len(laws)), amplitudes)
    needed = brentq(lambda squares: ncx2.sf(limit, amplitudes, squares) - POWER, 1.0, 1000.0)
    return float(np.max(np.hypot(*np.moveaxis(moved, -1, 0)))) * float(np.sqrt(needed / reported))


if __name__ == "__main__":
    main()
