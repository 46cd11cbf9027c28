"""Output of `semlive diagnose` on the experiments that would decide an open question."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from blind.cases import GRID, ONE, Case
from blind.imported import imported
from blind.observing import QUICK
from numexp.stated_estimate import state_estimate

Printed = tuple[int, str, str]


def test_an_open_verdict_predicts_what_experiments_decide(semlive: Callable[..., Printed], tmp_path: Path) -> None:
    case = Case(ONE, ("wrong_row_time",), 1.43, 1)
    log = state_estimate(imported(tmp_path / "maps", case.conditions(), case.effects(), GRID), QUICK)

    code, out, _ = semlive("diagnose", str(log), "--json", "--html", str(tmp_path / "page.html"))

    found = json.loads(out)
    assert code == 0
    assert (found["outcome"], found["ambiguous"]) == ("AMBIGUOUS", ["wrong_row_time", "scan_shear_drift"])
    menu = found["experiment"]["foretold"]
    assert {item["kind"] for item in menu} == {"parked", "again", "reversed", "other_scan", "longer_hold", "dummy_steps", "unload"}
    for item in menu:
        assert set(item) == {"kind", "dwell", "minutes", "log_odds", "log_odds_per_minute", "true", "other"}
        assert {item["true"], item["other"]} == set(found["ambiguous"])
        assert abs(item["log_odds_per_minute"] - item["log_odds"] / item["minutes"]) < 1e-12
        assert 10.0 < item["minutes"] < 300.0
    rates = [item["log_odds_per_minute"] for item in menu]
    assert rates == sorted(rates, reverse=True)
    page = (tmp_path / "page.html").read_text()
    assert all(word in page for word in ("Expected results of experiments", "other scan, 2 times the dwell", "ln odds per minute"))
