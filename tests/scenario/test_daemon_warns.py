"""A run with an effect that the model does not have: the operator gets one warning while it continues."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from semlive.service.log.files import messages

BENCH_EFFECTS = """
effects:
  magnification_frame_instability: {sd: 1.0e-3, seed: 1}
"""
PAIRS = 6
WARNING = "the residual of the maps after "


@pytest.fixture(scope="module")
def done(instrument: Callable[..., Any]) -> Any:
    one = instrument("unsteady")
    one.wait_for_slow_answers()
    one.config["protocol"].update(calibration_shifts_px=[[0, 0], [6, 0], [0, 6], [-6, 0], [0, -6]], loads_n=[600])
    code, printed = one.run()
    one.end_bench()
    assert code == 0, printed
    return one


def test_a_missing_effect_is_reported_once_with_advice(done: Any) -> None:
    logged_payloads = [(one.topic, json.loads(one.payload)) for one in messages(done.log) if one.topic in ("/fault", "/pair", "/result")]
    (fault,) = [payload for topic, payload in logged_payloads if topic == "/fault" and payload["what"].startswith(WARNING)]
    assert fault["where"] == "estimate with pair 4"  # the fifth: fewer pairs determine nothing
    assert "semlive diagnose LOG" in fault["action"]
    assert "test over the frame" in fault["what"]
    # The run continued, and its end reports the residual of all pairs.
    assert sum(topic == "/pair" for topic, _ in logged_payloads) == PAIRS
    (result,) = [payload for topic, payload in logged_payloads if topic == "/result"]
    assert sum(one.startswith(f"WARNING: {WARNING}{PAIRS} pairs") for one in result["warnings"]) == 1


def test_replay_and_report_repeat_the_warning(done: Any, semlive: Callable[..., tuple[int, str, str]]) -> None:
    page = done.folder / "report.html"
    for words in (("replay", done.log, "--from-disparity"), ("report", done.log, "-o", page)):
        code, out, err = semlive(*words)
        assert code == 0, err
        assert words[0] == "report" or "live and replayed results are identical" in out
    assert f"<li>{WARNING}{PAIRS} pairs" in page.read_text(encoding="utf-8")
