"""Hidden effects, named blindly: outcomes by effect and size, false names where nothing is hidden, and what has no name.

    python tests/benchmarks/bench_diagnose.py --set final --seeds 16 --sizes 2 4 8 --nulls 773 --doubles 100 --strange 25 \
        --deformed 10 --removed 3 --confounded 30 --folder tests/benchmarks/blind/final --shard 1/2
    python tests/benchmarks/bench_diagnose.py ... --folder tests/benchmarks/blind/final --score [--write]

A case is known to diagnosis by its data alone; verdicts are written by the case's key, and only scoring joins them with what was
hidden. An interrupted run continues where it stopped, and shards of one run write into one folder. Experiments are made by the
simulators' own effects at displacement level: 15 pairs, 0.02 px of noise shared over subsets, 1 % of the points missing, 0.1 % wrong;
where nothing is hidden number of pairs, noise and lost points vary. With --white points share no noise, none is lost or wrong: the same
effects at their plainest, in a folder of their own.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from blind.cases import GRID, ONE, Case, Counts, cases
from blind.experiment import Conditions
from blind.hiding import DETECTABLE_PX
from blind.nuisance import NUISANCES
from blind.observing import observed
from blind.outside import experiments, outside_table, store
from blind.scoring import Verdict, table

from semlive.data.diagnosis.verdict import Diagnosis
from semlive.diagnose.baseline.model_effects import add_model_effects
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.fit_tests.cross_validation import explained_fraction_of_truth
from semlive.diagnose.maps.relinearise import choose_coupling
from semlive.diagnose.maps.verdict import diagnose
from semlive.model.effects import EFFECT_CLASSES, EffectClass

PAGE = Path(__file__).parents[2] / "docs" / "validation" / "diagnosis.md"
CLOSURE_AT = [4.0, 16.0]
MEASURED, LARGEST, WHITE, OUTSIDE = "measured", "sixteen", "white", "outside"


def main() -> None:
    """Run what is missing, or score what is there."""
    arguments = _arguments()
    counts = Counts(
        arguments.seeds, arguments.nulls, arguments.doubles, arguments.strange, arguments.deformed, arguments.removed, arguments.confounded
    )
    listed = cases(arguments.set, counts, arguments.sizes, arguments.effects)
    chosen = [replace(entry, white=arguments.white, under=arguments.under) for entry in listed]
    arguments.folder.mkdir(parents=True, exist_ok=True)
    if not arguments.score:
        _run(chosen, arguments)
    printed = verdicts(arguments.folder)
    scored = [(case, printed[case.key]) for case in chosen if case.key in printed]
    found = table(scored)
    sys.stdout.write(found)
    if arguments.write:
        part = WHITE if arguments.white else LARGEST if arguments.sizes == CLOSURE_AT[1:] else MEASURED
        write(found, f"{len(scored)} of {len(chosen)} cases of the {arguments.set} set", part)
        if part == MEASURED:
            store(scored)
            write(outside_table(scored), f"{sum(map(len, experiments(scored).values()))} experiments in the calibration", OUTSIDE)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", choices=("development", "final"), default="development")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--sizes", type=float, nargs="*", default=[4.0, 8.0], help="times what can be detected")
    parser.add_argument("--effects", nargs="*", default=list(DETECTABLE_PX))
    parser.add_argument("--nulls", type=int, default=10)
    parser.add_argument("--doubles", type=int, default=0)
    parser.add_argument("--strange", type=int, default=0, help="of each effect that has no name, and each size")
    parser.add_argument("--deformed", type=int, default=0, help="of each effect whose law can be another")
    parser.add_argument("--removed", type=int, default=0, help="of each effect, the dictionary being without it")
    parser.add_argument("--confounded", type=int, default=0, help="of each effect that one experiment cannot separate from the baseline")
    parser.add_argument("--white", action="store_true", help="points share no noise, none is lost or wrong")
    parser.add_argument("--under", default="", choices=("", *NUISANCES), help="a condition that the usual cases do not have")
    parser.add_argument("--shard", default="1/1", help="k/n: every n-th case from the k-th on")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so long")
    parser.add_argument("--folder", type=Path, default=Path("blind"))
    parser.add_argument("--score", action="store_true", help="run nothing")
    parser.add_argument("--write", action="store_true", help="put the tables into docs/validation/diagnosis.md")
    return parser.parse_args()


def _run(chosen: list[Case], arguments: argparse.Namespace) -> None:
    own, shards = (int(entry) for entry in arguments.shard.split("/"))
    done, begin = verdicts(arguments.folder), time.monotonic()
    for case in chosen[own - 1 :: shards]:
        if time.monotonic() - begin > arguments.seconds:
            return
        if case.key not in done:
            observation = case.observed()
            found, verdict = judge(observation, case.dictionary())
            verdict["closure"] = closure(case, observation, found)
            with (arguments.folder / f"verdicts-{own}-of-{shards}.jsonl").open("a", encoding="utf-8") as stream:
                stream.write(json.dumps({"key": case.key, **verdict}) + "\n")


def judge(observation: Observation, dictionary: Sequence[EffectClass] = EFFECT_CLASSES) -> tuple[Diagnosis, Verdict]:
    """A verdict, knowing nothing but data."""
    begin = time.process_time()
    found = diagnose(observation, dictionary=dictionary)
    return found, {
        "outcome": found.outcome.value,
        "names": [entry.name for entry in found.effects],
        "ambiguous": list(found.ambiguous),
        "odds": [entry.log_bayes_factor for entry in found.effects],
        "parameters": {entry.name: {item.name: [item.value, item.sigma] for item in entry.parameters} for entry in found.effects},
        "loudest": max((odds for _, odds in found.evidence), default=None),
        "closure_told": None if found.gap is None else found.gap.closure,
        "adequacy": None if found.adequacy is None else [found.adequacy.domain, found.adequacy.p_value],
        "unexplained": [reason.text for reason in found.unexplained],
        "cpu_s": time.process_time() - begin,
    }


def closure(case: Case, observation: Observation, found: Diagnosis) -> float | None:
    """On held-out pairs, the floor being what the same data leave that have the same noise and nothing hidden in them."""
    if case.kind != ONE or case.size not in CLOSURE_AT or not found.effects:
        return None
    alone = _nothing_hidden(case.conditions())
    if not np.array_equal(alone.valid_blocks, observation.valid_blocks):
        return None
    laws = [entry.model_effect for entry in found.effects]
    plain = add_model_effects(noise_scaled_baseline(choose_coupling(observation, (), laws).observation), ())[0]
    with_effects = add_model_effects(plain, laws)[0]
    return explained_fraction_of_truth(plain, with_effects, alone.disparity_px, 0)


@lru_cache(maxsize=1)
def _nothing_hidden(conditions: Conditions) -> Observation:
    """Cases of one seed follow each other."""
    return observed(conditions, (), GRID)


def verdicts(folder: Path) -> dict[str, Verdict]:
    """All there are, by the key of their case."""
    lines = [line for path in sorted(folder.glob("verdicts-*.jsonl")) for line in path.read_text(encoding="utf-8").splitlines()]
    return {str(entry["key"]): entry for entry in map(json.loads, lines)}


def write(found: str, how_many: str, part: str = MEASURED) -> None:
    """Replace a measured part of the page."""
    begin, end = f"<!-- {part}: begin -->\n", f"<!-- {part}: end -->\n"
    page = PAGE.read_text(encoding="utf-8")
    before, rest = page.split(begin)
    after = rest.split(end)[1]
    PAGE.write_text(f"{before}{begin}\n{how_many}.\n\n{found}\n{end}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
