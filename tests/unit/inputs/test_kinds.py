"""A value keeps the kind that was given."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel

from semlive.inputs.kinds import changed_kind


@dataclass(frozen=True, slots=True)
class Inner:
    """Values inside."""

    rate: float = 1.0
    on: bool = False


class Outer(BaseModel):
    """Settings with every kind of value."""

    count: int = 0
    folder: Path = Path()
    pairs: tuple[tuple[float, float], ...] = ()
    inner: Inner = Inner()
    inners: list[Inner] = []
    either: int | str = 0


def kind(**given: object) -> tuple[tuple[str | int, ...], str] | None:
    return changed_kind(given, Outer.model_validate(given))


def test_values_within_bounds_are_retained() -> None:
    assert kind(count=3, folder="x", pairs=[[1, 2.5]], inner={"rate": 2, "on": True}, inners=[{"rate": 0.5}], either="text") is None
    assert kind() is None


def test_text_and_truth_values_are_no_numbers() -> None:
    assert kind(count="30") == (("count",), "'30' is text, not a number; write a finite number without quotes")
    assert kind(inner={"rate": True}) == (("inner", "rate"), "true is a truth value, not a number; write a finite number")
    assert kind(pairs=[[1, 2], [1, "2"]]) == (("pairs", 1, 1), "'2' is text, not a number; write a finite number without quotes")


def test_text_and_numbers_are_no_truth_values() -> None:
    assert kind(inner={"on": "yes"}) == (("inner", "on"), "'yes' is no truth value; write true or false")
    assert kind(inners=[{}, {"on": 1}]) == (("inners", 1, "on"), "1 is no truth value; write true or false")
