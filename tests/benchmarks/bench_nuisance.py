"""The blind set under conditions that its calibration did not have, with the rates of the usual conditions.

    python tests/benchmarks/bench_nuisance.py --seeds 8 --nulls 8 --folder tests/benchmarks/blind/nuisance [--shard 1/2] [--write]

For each condition of `blind/nuisance.py`, so many runs without an effect and so many with one at four times the detection limit; the
effects follow each other in their order. With any size, sizes are drawn over the range that occurs at x200, and only those of at least
four times the limit need a name. Under a bias of the correlation, this bias is correct with or without another effect. A wrong row time is
not counted where that of the blind set is not: where it causes less than twice its detection limit, or is inseparable from a shear.
Requirement: correct effects fall by at most 3 points, false effects stay at or below 1 %.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from bench_diagnose import judge
from blind.campaign import run
from blind.cases import FIRST_SEED, NOTHING, ONE, Case
from blind.hiding import DETECTABLE_PX
from blind.nuisance import BIAS, NUISANCES
from blind.scoring import at_least, at_most, judged, without_correlation_bias

USUAL = "usual"
Verdict = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Run:
    """A run of the campaign."""

    case: Case

    @property
    def key(self) -> str:
        """Of its verdict."""
        return self.case.key

    def verdict(self) -> Verdict:
        """With what it is worth."""
        _, found = judge(self.case.observed())
        about = {"under": self.case.under or USUAL, "law": self.case.names, "detectable": self.case.detectable}
        about |= {"faint": self.case.faint, "sheared": self.case.sheared}
        counted = without_correlation_bias(found) if self.case.under == BIAS else found
        return {"key": self.key, "kind": self.case.kind, **about, "judged": judged(self.case, counted), **found}


def cases(seeds: int, nulls: int) -> Iterator[Run]:
    """In an order in which each part holds all conditions."""
    names, conditions = tuple(DETECTABLE_PX), ("", *NUISANCES)
    for number in range(max(seeds, nulls)):
        for place, under in enumerate(conditions):
            if number < seeds:
                law = names[(number * 7 + place) % len(names)]
                yield Run(Case(ONE, (law,), 4.0, FIRST_SEED["nuisance"] + number, under=under))
            if number < nulls:
                yield Run(Case(NOTHING, (), 0.0, FIRST_SEED["nuisance"] + 5000 + number, under=under))


def table(verdicts: Sequence[Verdict]) -> str:
    """Counts of each condition, of all, and of the usual ones."""
    heads = "| condition | with an effect | correct | in the set | wrong | UNKNOWN | without | false | UNKNOWN |"
    rows = [heads, "|---" * 9 + "|"]
    for under in (USUAL, *NUISANCES):
        rows += [_row(under, [item for item in verdicts if item["under"] == under])]
    every = [item for item in verdicts if item["under"] != USUAL]
    rows += [_row("all but the usual", every), "", *_bounds(every), *_uncounted(verdicts), "", *_failures(verdicts)]
    return "\n".join([*rows, ""])


def _row(about: str, own: Sequence[Verdict]) -> str:
    one, nothing = _effects(own), [item for item in own if item["kind"] == NOTHING]
    worth = [item["judged"] for item in one]
    empty = [item["judged"] for item in nothing]
    false = sum(value in ("wrong", "set", "right") for value in empty)
    return (
        f"| {about} | {len(one)} | {worth.count('right')} | {worth.count('set')} | {worth.count('wrong')} "
        f"| {worth.count('UNKNOWN')} | {len(nothing)} | {false} | {empty.count('UNKNOWN')} |"
    )


def _effects(own: Sequence[Verdict]) -> list[Verdict]:
    """Those that need a name; a wrong name is counted for all."""
    return [item for item in own if item["kind"] == ONE and (_needs_name(item) or item["judged"] == "wrong")]


def _needs_name(item: Verdict) -> bool:
    return bool(item["detectable"] and not item["faint"] and not item["sheared"])


def _uncounted(verdicts: Sequence[Verdict]) -> list[str]:
    """Wrong row times that need no name, with their outcomes."""
    uncounted = Counter(item["judged"] for item in verdicts if item["kind"] == ONE and item["detectable"] and not _needs_name(item))
    if not uncounted:
        return []
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in uncounted.most_common())
    return [f"Not counted: `wrong_row_time` below twice its limit or inseparable from a shear: {outcomes}."]


def _bounds(own: Sequence[Verdict]) -> list[str]:
    one, nothing = _effects(own), [item for item in own if item["kind"] == NOTHING]
    right, wrong = (sum(item["judged"] == value for item in one) for value in ("right", "wrong"))
    false = sum(item["judged"] in ("wrong", "set", "right") for item in nothing)
    if not one or not nothing:
        return []
    return [
        f"Under these conditions {right} of {len(one)} correct (at least {100 * at_least(right, len(one)):.1f} %), {wrong} wrong (at most "
        f"{100 * at_most(wrong, len(one)):.1f} %); {false} of {len(nothing)} false without an effect (at most "
        f"{100 * at_most(false, len(nothing)):.1f} %)."
    ]


def _failures(verdicts: Sequence[Verdict]) -> list[str]:
    failed = [item for item in _effects(verdicts) if item["judged"] != "right"]
    failed += [item for item in verdicts if item["kind"] == NOTHING and item["judged"] != "NONE"]
    return [f"- {item['under']}, {' + '.join(item['law']) or NOTHING}: {item['outcome']} {item['names']}" for item in failed]


if __name__ == "__main__":
    run(__doc__, "nuisance", cases, table)
