"""Where two results differ."""

from __future__ import annotations

from semlive.service.analysis.result_json import json_differences


def test_equal_results_have_no_differences() -> None:
    assert json_differences({"a": [1.0, {"b": None}]}, {"a": [1.0, {"b": None}]}) == []


def test_a_difference_is_named_by_its_place() -> None:
    before = {"frames": [{"eyy": 1.0}, {"eyy": 2.0}], "pairs": 1}
    after = {"frames": [{"eyy": 1.0}, {"eyy": 2.5}], "pairs": 1, "more": True}
    assert json_differences(before, after) == ["frames.1.eyy: 2.0 became 2.5", "more: None became True"]
