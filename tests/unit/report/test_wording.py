"""Numbers in the text of reports."""

from __future__ import annotations

import pytest

from semlive.report.sections.wording import NOT_RECORDED, counted, joined, seconds, utc_date, utc_time, with_sigma


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (71.1876, 0.2634, "71.19 ± 0.26 GPa"),
        (71.1576, 0.07399, "71.158 ± 0.074 GPa"),
        (71.1576, 0.0996, "71.16 ± 0.10 GPa"),
        (71.1576, 3.2, "71.2 ± 3.2 GPa"),
        (1234.5, 27.2, "1234 ± 27 GPa"),
        (-0.5, 0.95, "-0.50 ± 0.95 GPa"),
    ],
)
def test_an_uncertainty_has_two_digits_and_the_value_its_decimals(value: float, sigma: float, text: str) -> None:
    assert with_sigma(value, sigma, "GPa") == text


def test_small_and_large_values_have_a_power_of_ten() -> None:
    assert with_sigma(1.2e-6, 4e-7, "1/s") == "(1.20 ± 0.40) · 10⁻⁶ 1/s"
    assert with_sigma(1e-9, 4.06e-7) == "(0.0 ± 4.1) · 10⁻⁷"
    assert with_sigma(2.345e8, 1.1e6) == "(2.345 ± 0.011) · 10⁸"


@pytest.mark.parametrize("sigma", [0.0, float("inf"), float("nan")])
def test_a_missing_uncertainty_is_named(sigma: float) -> None:
    assert with_sigma(71.2, sigma, "GPa") == f"71.2 GPa (uncertainty {NOT_RECORDED})"


def test_dates_are_utc_and_english() -> None:
    assert (utc_date(1_795_688_108_158_812_000), utc_time(1_795_688_108_158_812_000)) == ("26 November 2026", "10:15")


def test_lists_and_counts_as_text() -> None:
    assert [joined(words) for words in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == ["", "a", "a and b", "a, b and c"]
    assert [counted(1, "pair"), counted(2, "pair")] == ["1 pair", "2 pairs"]


def test_a_time_has_the_unit_of_few_digits() -> None:
    assert [seconds(time_s) for time_s in (1e-4, 0.10709276, 94.67)] == ["100 µs", "107.1 ms", "94.67 s"]
