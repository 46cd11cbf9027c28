"""Rows that were registered by themselves: waves by their frequency, jitter by its size, nothing where there is nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semlive.data.diagnosis.channels import RowDiagnosis
from semlive.data.diagnosis.effects import IdentifiedEffect, ModelEffect, Outcome
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.diagnose.combine import add_row_verdict
from semlive.diagnose.rows.series import RowSeries, interpolated
from semlive.diagnose.rows.verdict import diagnose_rows
from semlive.errors import IllPosed

ROWS, PIECES, WIDTH_PX, PASSED = 420, 12, 42.0, 0.8
SIGMA_PX = 0.12


def series(seed: int, pairs: int = 4, hz: float = 0.0, size_px: float = 0.0, jitter_px: float = 0.0, rows: int = ROWS) -> list[RowSeries]:
    """Pairs whose frames both have a wave of random phase along x and half of it along y, and jitter along x."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(pairs):
        shape = (2, rows, PIECES)
        item = RowSeries(
            SIGMA_PX * rng.standard_normal(shape), np.full(shape, SIGMA_PX**-2.0), np.arange(3.0, 3.0 + rows),
            np.linspace(0.5 * WIDTH_PX, (PIECES - 0.5) * WIDTH_PX, PIECES), WIDTH_PX, 0.1071, 1e-4, PASSED,
        )  # fmt: skip
        first, second = (np.sin(item.phase(hz) + phase) for phase in rng.uniform(0.0, 2.0 * np.pi, 2))
        wave = size_px * float(item.observed_wave(hz)) * (second - first) * np.array([1.0, 0.5])[:, None, None]
        fresh = jitter_px * np.sqrt(1.0 + PASSED) * rng.standard_normal((rows, 1)) * np.array([1.0, 0.0])[:, None, None]
        found.append(replace(item, shift_px=item.shift_px + wave + fresh))
    return found


def values_and_sigmas(found: RowDiagnosis, name: str) -> dict[str, tuple[float, float]]:
    (effect,) = [item for item in found.effects if item.name == name]
    return {item.name: (item.value, item.sigma) for item in effect.parameters}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_is_named_where_nothing_is(seed: int) -> None:
    found = diagnose_rows(series(seed))
    assert (found.outcome, found.effects, found.gap) == (Outcome.NONE, (), None)
    assert all(item.p_value > 0.01 for item in found.where)


@pytest.mark.parametrize(("hz", "name"), [(50.0, "mains_hum"), (120.0, "mains_hum"), (23.7, "vibration")])
def test_a_wave_is_named_by_its_frequency(hz: float, name: str) -> None:
    found = diagnose_rows(series(5, hz=hz, size_px=0.04))
    assert (found.outcome, [item.name for item in found.effects]) == (Outcome.IDENTIFIED, [name])
    parameters = values_and_sigmas(found, name)
    assert abs(parameters["frequency_hz"][0] - hz) < 4.0 * parameters["frequency_hz"][1] < 0.05
    # What four pairs show of it hangs on eight phases.
    assert abs(parameters["amplitude_x_px"][0] - 0.04) < 3.0 * parameters["amplitude_x_px"][1] < 0.04
    assert found.gap is not None
    assert found.gap.closure > 0.8


@pytest.mark.parametrize(("share", "lines", "names"), [(0.03, 0.8, 1), (0.03, 8.0, 2)])
def test_a_side_line_of_a_wave_is_no_second_wave(share: float, lines: float, names: int) -> None:
    """A wave whose amplitude changes within the frame, as by interpolation between rows, has weak lines close to its own."""
    item = series(5, pairs=6, hz=23.17, size_px=1.0)
    changing = [replace(one, shift_px=one.shift_px * (1.0 + 0.009 * np.linspace(-1.0, 1.0, ROWS)[:, None] ** 3)) for one in item]
    near = series(6, pairs=6, hz=23.17 + lines / item[0].duration_s, size_px=share)
    both = [replace(one, shift_px=one.shift_px + other.shift_px) for one, other in zip(changing, near, strict=True)]
    found = diagnose_rows(both)
    assert found.outcome is Outcome.IDENTIFIED
    assert len([value for value in values_and_sigmas(found, "vibration") if value.endswith("hz")]) == names


def test_jitter_is_found_as_large_as_it_is_and_not_called_a_wave() -> None:
    found = diagnose_rows(series(6, jitter_px=0.2))
    assert (found.outcome, [item.name for item in found.effects]) == (Outcome.IDENTIFIED, ["row_jitter"])
    assert values_and_sigmas(found, "row_jitter")["sd_x_px"][0] == pytest.approx(0.2, rel=0.08)  # 1,680 rows know it to 2 %
    assert values_and_sigmas(found, "row_jitter")["sd_y_px"][0] < 0.02


def test_a_slow_wave_is_not_called_jitter() -> None:
    found = diagnose_rows(series(7, hz=1.5, size_px=0.3, jitter_px=0.1))
    assert [item.name for item in found.effects] == ["vibration", "row_jitter"]
    assert values_and_sigmas(found, "row_jitter")["sd_x_px"][0] == pytest.approx(0.1, rel=0.1)


def test_what_the_model_has_is_not_found_again() -> None:
    rows = series(5, hz=50.0, size_px=0.04)
    (effect,) = diagnose_rows(rows).effects
    assert diagnose_rows(rows, model_effects=[effect.model_effect]).outcome is Outcome.NONE
    assert diagnose_rows(series(6, jitter_px=0.1), model_effects=[ModelEffect("row_jitter", (), 0.1)]).outcome is Outcome.NONE


def test_between_rows_a_fast_wave_is_averaged_away() -> None:
    between = np.array([0.0, 0.5])
    assert interpolated(0.0, between) == pytest.approx([1.0, 1.0])
    assert interpolated(0.5, between) == pytest.approx([1.0, 0.0], abs=1e-12)
    assert interpolated(0.1, between) == pytest.approx([1.0, 1.0], abs=0.01)
    assert interpolated(2.538, np.array([0.3])) == pytest.approx(interpolated(0.462, np.array([0.3])))
    (item,) = series(1, pairs=1)
    assert item.frames(50.0) == 2.0
    assert replace(item, subrow_position=np.full(ROWS, 0.5)).frames(0.5 / 0.1071) == pytest.approx(1.0)


def test_few_rows_are_reported() -> None:
    with pytest.raises(IllPosed, match="fewer than 100"):
        diagnose_rows(series(1, rows=90))


@pytest.fixture(scope="module")
def humming() -> RowDiagnosis:
    """A verdict on rows."""
    return diagnose_rows(series(5, pairs=2, hz=50.0, size_px=0.1))


def of_maps(outcome: Outcome, *names: str) -> Diagnosis:
    effects = tuple(IdentifiedEffect(name, (), 0.1, 20.0, 0.003, False, ModelEffect(name, (), 0.1)) for name in names)
    return Diagnosis(outcome, effects, (), None, None, None, (), 0.01)


@pytest.mark.parametrize(
    ("outcome", "names", "joint"),
    [
        (Outcome.NONE, (), Outcome.IDENTIFIED),
        (Outcome.IDENTIFIED, ("tilt_with_load",), Outcome.IDENTIFIED),
        (Outcome.UNKNOWN, ("tilt_with_load",), Outcome.UNKNOWN),
        (Outcome.REJECTED, ("tilt_with_load",), Outcome.REJECTED),
    ],
)
def test_rows_do_not_make_good_what_maps_cannot_explain(
    humming: RowDiagnosis, outcome: Outcome, names: tuple[str, ...], joint: Outcome
) -> None:
    found = add_row_verdict(of_maps(outcome, *names), humming)
    assert found.outcome is joint
    assert [item.name for item in found.effects] == [*names, "mains_hum"]
    assert {"row_waves", "row_common"} <= {item.domain for item in found.where}
