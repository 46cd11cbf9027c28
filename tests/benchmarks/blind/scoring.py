"""Verdicts against the truth, with one-sided bounds."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from blind.cases import CONFOUNDED, DEFORMED_LAW, NOTHING, ONE, REMOVED, TWO, UNLISTED, Case
from blind.hiding import DETECTABLE_PX, PHYSICAL_PX
from scipy.stats import beta

LEVEL = 0.95
CORRELATION_BIAS = "dic_subpixel_bias"
NORMAL_90 = 1.645  # standard deviations of an interval of 90 %
Verdict = dict[str, object]
Scored = Sequence[tuple[Case, Verdict]]


def at_least(count: int, total: int) -> float:
    """Clopper and Pearson's one-sided 95 % lower bound of a share."""
    return 0.0 if count == 0 else float(beta.ppf(1.0 - LEVEL, count, total - count + 1))


def at_most(count: int, total: int) -> float:
    """The upper bound."""
    return 1.0 if count == total else float(beta.ppf(LEVEL, count + 1, total - count))


def judged(case: Case, verdict: Verdict) -> str:
    """What a verdict is worth: right, set (truth among several), wrong, or the outcome that names nothing."""
    outcome, names, alternatives = str(verdict["outcome"]), _names(verdict["names"]), _names(verdict["ambiguous"])
    if outcome == "IDENTIFIED":
        return "right" if sorted(names) == sorted(case.names) else "wrong"
    if outcome == "AMBIGUOUS":
        return "set" if set(case.names) <= {*names, *alternatives} and case.names else "wrong"
    return outcome


def without_correlation_bias(verdict: Verdict) -> Verdict:
    """Verdict on data that have the bias of the correlation, with or without a further effect: the bias is correct, not false."""
    names = _names(verdict["names"])
    remaining = [entry for entry in names if entry != CORRELATION_BIAS]
    nothing = verdict["outcome"] == "IDENTIFIED" and not remaining
    return {**verdict, "names": remaining, "outcome": "NONE" if nothing else verdict["outcome"]}


def _names(names: object) -> list[str]:
    return [str(item) for item in names] if isinstance(names, list) else []


@dataclass(frozen=True, slots=True)
class Bar:
    """One thing that must be shown.

    Attributes:
        about: what.
        count: of cases that do it.
        total: of cases.
        limit: share.
        below: whether the share must lie below the limit.
    """

    about: str
    count: int
    total: int
    limit: float
    below: bool

    def row(self) -> str:
        """Of the table."""
        bound = at_most(self.count, self.total) if self.below else at_least(self.count, self.total)
        share = self.count / self.total
        met = bound <= self.limit if self.below else bound >= self.limit
        printed = "met" if met else "open" if (share <= self.limit if self.below else share >= self.limit) else "missed"
        return f"| {self.about} | {self.total} | {100 * share:.1f} % | {100 * bound:.1f} % | {self._required()} | {printed} |"

    def _required(self) -> str:
        return f"{'at most' if self.below else 'at least'} {100 * self.limit:g} %"


def bars(scored: Scored) -> Iterable[Bar]:
    """All that shares can be stated of; cases that are faint at their largest are listed separately.

    An effect inseparable from a shear need not be named, only not misnamed: it counts in all rows but that of right names.
    """
    by = defaultdict(list)
    scored = [(case, verdict) for case, verdict in scored if not case.faint]
    for case, verdict in scored:
        by[case.kind, case.size].append(judged(case, verdict))
    nulls = by[NOTHING, 0.0]
    named = [item for item in nulls if item in ("wrong", "right", "set")]
    yield Bar("false effects without a hidden effect", len(named), len(nulls), 0.01, below=True)
    yield Bar("UNKNOWN without a hidden effect", nulls.count("UNKNOWN"), len(nulls), 0.01, below=True)
    requests = {2.0: 0.85, 4.0: 0.97, 8.0: 0.99}
    sizes = sorted({case.size for case, _ in scored if case.kind == ONE})
    for size in sizes:
        printed = by[ONE, size]
        if size in requests:
            distinct = [judged(case, item) for case, item in scored if (case.kind, case.size) == (ONE, size) and not case.sheared]
            yield Bar(f"correct effect at {size:g} times", distinct.count("right"), len(distinct), requests[size], below=False)
        if size >= 4.0:
            yield Bar(
                f"truth in the stated set at {size:g} times", printed.count("right") + printed.count("set"), len(printed), 0.99, below=False
            )
        yield Bar(f"wrong effect IDENTIFIED at {size:g} times", printed.count("wrong"), len(printed), 0.01, below=True)
    doubles = [(case, verdict) for case, verdict in scored if case.kind == TWO]
    both = sum(set(case.names) <= set(_names(verdict["names"])) for case, verdict in doubles)
    yield Bar("two effects at 8 times, both found", both, len(doubles), 0.95, below=False)
    yield Bar("two effects at 8 times, and no other", by[TWO, 8.0].count("right"), len(doubles), 0.90, below=False)
    for size, limit in ((0.1, 0.95), (0.03, 0.85)):
        printed = by[UNLISTED, size]
        yield Bar(f"UNKNOWN for an unlisted effect, {size:g} px", printed.count("UNKNOWN"), len(printed), limit, below=False)
    modified = [(case, verdict) for case, verdict in scored if case.kind == DEFORMED_LAW]
    correct = by[DEFORMED_LAW, 8.0].count("right")
    yield Bar("correct effect and no other at 8 times, modified time course", correct, len(modified), 0.97, below=False)
    in_names = sum(set(case.names) <= {*_names(verdict["names"]), *_names(verdict["ambiguous"])} for case, verdict in modified)
    yield Bar("true effect among those named at 8 times, modified time course", in_names, len(modified), 0.97, below=False)
    removed = [verdict["outcome"] for case, verdict in scored if case.kind == REMOVED]
    yield Bar("UNKNOWN at 8 times, removed from the dictionary", removed.count("UNKNOWN"), len(removed), 0.90, below=False)
    confounded = [verdict["outcome"] for case, verdict in scored if case.kind == CONFOUNDED]
    yield Bar("IDENTIFIED although not separable by one run", confounded.count("IDENTIFIED"), len(confounded), 0.01, below=True)


def table(scored: Scored) -> str:
    """All that there are cases of, as Markdown."""
    rows = (item.row() for item in bars(scored) if item.total)
    lines = ["| | cases | share | bound, one-sided 95 % | required | |", "|---|---|---|---|---|---|", *rows, ""]
    return (
        "\n".join(
            [*lines, *_faint(scored), *_sheared(scored), *_each_effect(scored), *_sizes(scored), *_each_parameter(scored), *_missed(scored)]
        )
        + "\n"
    )


def _faint(scored: Scored) -> list[str]:
    printed = Counter(str(item["outcome"]) + (", right" if judged(case, item) == "right" else "") for case, item in scored if case.faint)
    if not printed:
        return []
    counted = ", ".join(f"{count} {outcome}" for outcome, count in printed.most_common())
    return [
        f"Not counted above: `wrong_row_time` where twice the stated row time causes less than twice the detection limit: {counted}.",
        "",
    ]


def _sheared(scored: Scored) -> list[str]:
    """With and without what looks like a shear: the rule and what it changes."""
    lines = []
    for size in sorted({case.size for case, _ in scored if case.kind == ONE}):
        every = [(case, judged(case, item)) for case, item in scored if (case.kind, case.size) == (ONE, size) and not case.faint]
        shears = [word for case, word in every if case.sheared]
        if shears:
            counted = ", ".join(f"{count} {_WORDS.get(word, word)}" for word, count in Counter(shears).most_common())
            right = sum(word == "right" for _, word in every)
            lines.append(f"- {size:g} times: {counted}; with them {right} of {len(every)} correct ({100 * right / len(every):.1f} %).")
    if not lines:
        return []
    rule = "Not among the correct effects: `wrong_row_time` that differs from a drifting shear by less than the limit (G3)."
    return [rule, "", *lines, ""]


def _each_effect(scored: Scored) -> list[str]:
    sizes = sorted({case.size for case, _ in scored if case.kind == ONE})
    lines = ["| effect | " + " | ".join(f"{size:g} times" for size in sizes) + " |", "|---" * (len(sizes) + 1) + "|"]
    for name in DETECTABLE_PX:
        cells = []
        for size in sizes:
            printed = [judged(case, item) for case, item in scored if case.kind == ONE and case.names == (name,) and case.size == size]
            cells.append(f"{printed.count('right')} of {len(printed)}")
        beyond = 2.0 * DETECTABLE_PX[name] > PHYSICAL_PX[name][1]
        lines.append(f"| `{name}`{' (2 times is more than occurs at x200)' if beyond else ''} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def _sizes(scored: Scored) -> list[str]:
    lines = ["| size | closure, median | closure, 5th percentile | error of parameters, median | inside stated 90 % | CPU time, median |"]
    lines.append("|---|---|---|---|---|---|")
    for size in sorted({case.size for case, _ in scored if case.kind == ONE}):
        right = [(case, item) for case, item in scored if case.kind == ONE and case.size == size and judged(case, item) == "right"]
        if not right:
            continue
        closures = [float(str(item["closure"])) for _, item in right if item["closure"] is not None]
        errors = [pair for case, item in right for pair in _errors(case, item)]
        cpu_s = float(np.median([float(str(item["cpu_s"])) for _, item in right]))
        middle, low = (f"{np.quantile(closures, share):.3f}" if closures else "" for share in (0.5, 0.05))
        error, inside = (float(np.median([pair[0] for pair in errors])), float(np.mean([pair[1] for pair in errors]))) if errors else (0, 0)
        parts = (middle, low, f"{100 * error:.1f} %", f"{100 * inside:.0f} % of {len(errors)}", f"{cpu_s:.1f} s")
        lines.append(f"| {size:g} times | " + " | ".join(parts) + " |")
    return [*lines, ""]


def _each_parameter(scored: Scored) -> list[str]:
    """Deviations in stated standard uncertainties. Cases of one seed have the same noise at every size, so sizes are not pooled."""
    sizes = sorted({case.size for case, _ in scored if case.kind == ONE})
    deviations: dict[tuple[str, str], dict[float, list[float]]] = defaultdict(lambda: defaultdict(list))
    for case, item in scored:
        if case.kind == ONE and judged(case, item) == "right":
            (name,), parameters = case.names, item["parameters"]
            own = parameters.get(name, {}) if isinstance(parameters, dict) else {}
            for parameter, true in {**case.truth()[name], **case.constants()}.items():
                if parameter in own:
                    value, sigma = own[parameter]
                    deviations[name, parameter][case.size].append((value - true) / sigma)
    lines = ["| effect | parameter | " + " | ".join(f"{size:g} times" for size in sizes) + " |", "|---" * (len(sizes) + 2) + "|"]
    for (name, parameter), by_size in deviations.items():
        cells = [_deviations(by_size[size]) if by_size[size] else "" for size in sizes]
        lines.append(f"| `{name}` | `{parameter}` | " + " | ".join(cells) + " |")
    return [*lines, ""] if deviations else []


def _deviations(each: Sequence[float]) -> str:
    return f"{np.sqrt(np.mean(np.square(each))):.2f}, {sum(abs(one) < NORMAL_90 for one in each)} of {len(each)}"


def _errors(case: Case, verdict: Verdict) -> Iterable[tuple[float, bool]]:
    """Relative error of each parameter, and whether the stated 90 % interval holds the truth."""
    parameters = verdict["parameters"]
    for name, values in case.truth().items():
        own = parameters.get(name, {}) if isinstance(parameters, dict) else {}
        for item, true in values.items():
            if item in own:
                value, sigma = own[item]
                yield abs(value - true) / abs(true), abs(value - true) < NORMAL_90 * sigma


def _missed(scored: Scored) -> list[str]:
    found = [
        (case, item) for case, item in scored if judged(case, item) not in ("right", "set") and (case.kind, item["outcome"]) not in _FINE
    ]
    return [
        f"- {_KINDS.get(case.kind, case.kind)} {' + '.join(case.names)}, {case.size:g}, seed {case.seed}: {item['outcome']} {item['names']}"
        for case, item in found
    ]


_WORDS = {"right": "correct", "set": "AMBIGUOUS with the truth in the set", "wrong": "wrong effect"}
_KINDS = {ONE: "single", TWO: "two", UNLISTED: "unlisted", DEFORMED_LAW: "modified", REMOVED: "removed", CONFOUNDED: "not separable"}
_FINE = {
    (NOTHING, "NONE"),
    (UNLISTED, "UNKNOWN"),
    (REMOVED, "UNKNOWN"),
    (CONFOUNDED, "NONE"),
    (CONFOUNDED, "UNKNOWN"),
    (CONFOUNDED, "AMBIGUOUS"),
}
