"""Scores of experiments with at most listed effects, for the p-value of anything outside the catalogue."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from blind.cases import CONFOUNDED, NOTHING, ONE, TWO, UNLISTED, Case
from blind.scoring import Scored, at_most

from semlive.data.diagnosis.effects import Outcome
from semlive.diagnose.fit_tests.outside_catalogue import RANKS, SCORES, conformal_p_value, rank

STORED = Path(__file__).parents[3] / "semlive" / "diagnose" / "fit_tests" / SCORES
WITH, WITHOUT = "with effects", "without an effect"
LEVELS = 0.01, 0.05


def experiments(scored: Scored) -> dict[str, dict[int, int]]:
    """Highest rank of each experiment, by group and seed; nothing from outside the catalogue is among them."""
    found: dict[str, dict[int, int]] = {WITHOUT: {}, WITH: {}}
    for case, verdict in scored:
        if case.kind in (NOTHING, ONE, TWO, CONFOUNDED):
            group = found[WITHOUT if case.kind == NOTHING else WITH]
            group[case.seed] = max(group.get(case.seed, 0), _rank(verdict))
    return found


def p_value(score: int, calibration: dict[str, dict[int, int]]) -> float:
    """The larger of both groups."""
    return max(conformal_p_value(score, list(group.values())) for group in calibration.values())


def held_out(scored: Scored) -> dict[tuple[str, ...], list[float]]:
    """p-values of the verdicts on each law, or set of laws, with a calibration that has none of its verdicts."""
    laws = sorted({case.names for case, _ in scored if case.kind in (ONE, TWO, CONFOUNDED)})
    found = {}
    for law in laws:
        rest = experiments([(case, verdict) for case, verdict in scored if not set(case.names) & set(law)])
        found[law] = [p_value(_rank(verdict), rest) for case, verdict in scored if case.names == law and _listed(case)]
    return found


def unlisted(scored: Scored) -> list[float]:
    """p-values of the verdicts on unlisted effects."""
    calibration = experiments(scored)
    return [p_value(_rank(verdict), calibration) for case, verdict in scored if case.kind == UNLISTED]


def outside_table(scored: Scored) -> str:
    """Coverage and power."""
    laws = held_out(scored)
    rows = [
        _row(f"{len(laws)} laws and pairs of laws, each left out of the calibration", [value for own in laws.values() for value in own]),
        _row("the same, smallest p-value of each", [min(own) for own in laws.values()]),
        _row("unlisted effects", unlisted(scored)),
    ]
    heads = "| verdicts on | number | " + " | ".join(f"p at most {level:g}" for level in LEVELS) + " |"
    return "\n".join([heads, "|---" * (2 + len(LEVELS)) + "|", *rows, ""])


def store(scored: Scored) -> None:
    """Write how often each rank occurs into the program."""
    groups = {name: Counter(group.values()) for name, group in experiments(scored).items()}
    ranks = range(max(RANKS.values()) + 1)
    STORED.write_text(json.dumps({name: [counts[at] for at in ranks] for name, counts in groups.items()}) + "\n", encoding="utf-8")


def _row(about: str, values: Sequence[float]) -> str:
    counts = [sum(value <= level for value in values) for level in LEVELS]
    shares = [
        f"{count} ({100 * count / len(values):.1f} %, at most {100 * at_most(count, len(values)):.1f} %)" for count in counts if values
    ]
    return f"| {about} | {len(values)} | {' | '.join(shares)} |"


def _listed(case: Case) -> bool:
    return case.kind in (ONE, TWO, CONFOUNDED)


def _rank(verdict: dict[str, object]) -> int:
    return rank(Outcome(str(verdict["outcome"])))
