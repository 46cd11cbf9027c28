"""Scoring of hidden effects: bounds are exact, keys reveal nothing, and every verdict is scored by its statement."""

from __future__ import annotations

import numpy as np
import pytest
from blind.cases import CONFOUNDED, DEFORMED_LAW, GRID, NOTHING, ONE, REMOVED, TWO, UNLISTED, Case, Counts, cases, peak_px
from blind.deformed import DEFORMED
from blind.experiment import beyond_shear_px, hidden, largest_px
from blind.hiding import DETECTABLE_PX, PHYSICAL_PX, PROTOTYPE_PX
from blind.scoring import at_least, at_most, judged, table
from numexp.noise import NoiseKind

from semlive.data.disparity import PoiStatus


def verdict(outcome: str, names: list[str], ambiguous: list[str] | None = None) -> dict[str, object]:
    return {"outcome": outcome, "names": names, "ambiguous": ambiguous or [], "parameters": {}, "closure": 1.0, "cpu_s": 1.0}


@pytest.mark.parametrize(("count", "total", "bound"), [(0, 299, 0.00997), (1, 473, 0.00999), (3, 773, 0.00999)])
def test_the_upper_bound_is_that_of_clopper_and_pearson(count: int, total: int, bound: float) -> None:
    assert at_most(count, total) == pytest.approx(bound, abs=2e-5)
    assert at_least(total - count, total) == pytest.approx(1.0 - at_most(count, total))


@pytest.mark.parametrize(
    ("case", "row_time_errors", "worth"),
    [
        (Case(ONE, ("stage_yaw",), 4.0, 1), verdict("IDENTIFIED", ["stage_yaw"]), "right"),
        (Case(ONE, ("stage_yaw",), 4.0, 1), verdict("IDENTIFIED", ["stage_yaw", "drift_jump"]), "wrong"),
        (Case(ONE, ("stage_yaw",), 4.0, 1), verdict("AMBIGUOUS", ["raster_rotation_drift"], ["raster_rotation_drift", "stage_yaw"]), "set"),
        (Case(ONE, ("stage_yaw",), 4.0, 1), verdict("AMBIGUOUS", ["aspect_drift"], ["aspect_drift", "creep_in_hold"]), "wrong"),
        (Case(TWO, ("a", "b"), 8.0, 1), verdict("IDENTIFIED", ["b", "a"]), "right"),
        (Case(NOTHING, (), 0.0, 1), verdict("IDENTIFIED", ["stage_yaw"]), "wrong"),
        (Case(UNLISTED, ("spiral_drift",), 0.1, 1), verdict("UNKNOWN", ["stage_yaw"]), "UNKNOWN"),
        (Case(CONFOUNDED, ("flyback_settling",), 1.0, 1), verdict("NONE", []), "NONE"),
    ],
)
def test_a_verdict_is_worth_what_it_reports(case: Case, row_time_errors: dict[str, object], worth: str) -> None:
    assert judged(case, row_time_errors) == worth


@pytest.mark.parametrize("name", ["bending_misalignment", "load_step_transient", "magnification_frame_instability", "wrong_row_time"])
def test_an_effect_is_as_large_in_the_maps_as_is_reported(name: str) -> None:
    case = Case(ONE, (name,), 4.0, 3)
    assert largest_px(case.conditions(), case.effects()) == pytest.approx(4.0 * DETECTABLE_PX[name], rel=2e-3)


def test_no_effect_is_larger_than_is_met() -> None:
    assert peak_px("bending_misalignment", 4.0) == 4.0 * DETECTABLE_PX["bending_misalignment"]
    assert peak_px("bending_misalignment", 16.0) == PHYSICAL_PX["bending_misalignment"][1]
    assert peak_px("scan_shear_drift", 8.0) == PHYSICAL_PX["scan_shear_drift"][1]


def test_no_row_takes_more_than_twice_what_is_stated_and_what_that_hardly_shows_is_listed() -> None:
    wrong = [Case(ONE, ("wrong_row_time",), 8.0, seed) for seed in (1, 2, 8)]  # the less the rate of the drift changes
    row_time_errors = [case.truth()["wrong_row_time"]["row_time_error"] for case in wrong]

    assert row_time_errors == [pytest.approx(0.914, abs=1e-3), 1.0, 1.0]
    assert [case.faint for case in wrong] == [False, False, True]
    printed = table([(case, verdict("AMBIGUOUS", ["wrong_row_time"], ["wrong_row_time", "scan_shear_drift"])) for case in wrong])
    assert "| correct effect at 8 times | 2 | 0.0 % |" in printed
    assert "less than twice the detection limit: 1 AMBIGUOUS." in printed


def test_a_wrong_row_time_that_looks_like_a_shear_need_not_be_named_but_not_misnamed() -> None:
    shear = Case(ONE, ("scan_shear_drift",), 2.0, 7)
    assert largest_px(shear.conditions(), shear.effects()) > 0.02
    assert beyond_shear_px(shear.conditions(), shear.effects()) < 0.05 * largest_px(shear.conditions(), shear.effects())
    distinct, similar = (
        Case(ONE, ("wrong_row_time",), 4.0, seed) for seed in (1, 7)
    )  # the rate of the drift along y changes by 51 and by 3 %
    assert (distinct.sheared, similar.sheared, shear.sheared) == (False, True, False)
    both = [(case, verdict("AMBIGUOUS", ["scan_shear_drift"], ["scan_shear_drift", "wrong_row_time"])) for case in (distinct, similar)]
    printed = table(both)
    assert "| correct effect at 4 times | 1 | 0.0 % |" in printed
    assert "| truth in the stated set at 4 times | 2 | 100.0 % |" in printed
    assert "- 4 times: 1 AMBIGUOUS with the truth in the set; with them 0 of 2 correct (0.0 %)." in printed
    printed = table([(similar, verdict("IDENTIFIED", ["stage_yaw"]))])
    assert "| wrong effect IDENTIFIED at 4 times | 1 | 100.0 % |" in printed


def test_seeds_of_the_final_set_are_never_those_of_development() -> None:
    counts = Counts(seeds=16, nulls=773, doubles=50, strange=25, deformed=5, removed=3, confounded=30)
    requests = {"counts": counts, "sizes": (2.0, 4.0), "names": tuple(DETECTABLE_PX)}
    development, final = ({(item.seed) for item in cases(which, **requests)} for which in ("development", "final"))
    assert not development & final
    listed = list(cases("final", **requests))
    assert (
        len({item.key for item in listed}) == len(listed) == 16 * 2 * len(DETECTABLE_PX) + 773 + 50 + 25 * 6 * 2 + 5 * 10 + 3 * 19 + 30 * 10
    )


def test_the_dictionary_excludes_a_removed_effect_and_a_deformed_law_is_a_separate_case() -> None:
    removed, usual = Case(REMOVED, ("stage_yaw",), 8.0, 1), Case(ONE, ("stage_yaw",), 8.0, 1)
    assert {item.name for item in usual.dictionary()} - {item.name for item in removed.dictionary()} == {"stage_yaw"}
    for name in DEFORMED:
        bent = Case(DEFORMED_LAW, (name,), 8.0, 3)
        assert largest_px(bent.conditions(), bent.effects()) == pytest.approx(peak_px(name, 8.0), rel=2e-2)
        assert type(bent.effects()[0]) is not type(Case(ONE, (name,), 8.0, 3).effects()[0])


def test_a_table_reports_what_is_met_and_what_is_open() -> None:
    nulls = [(Case(NOTHING, (), 0.0, seed), verdict("NONE", [])) for seed in range(299)]
    few = [(Case(ONE, ("stage_yaw",), 4.0, 1), verdict("IDENTIFIED", ["stage_yaw"]))]
    printed = table([*nulls, *few])
    assert "| false effects without a hidden effect | 299 | 0.0 % | 1.0 % | at most 1 % | met |" in printed
    assert "| correct effect at 4 times | 1 | 100.0 % | 5.0 % | at least 97 % | open |" in printed


def test_sizes_beyond_the_practical_range_are_recognised() -> None:
    assert [name for name, size in DETECTABLE_PX.items() if 2.0 * size > PHYSICAL_PX[name][1]] == []
    assert [name for name, size in PROTOTYPE_PX.items() if 2.0 * size > PHYSICAL_PX[name][1]] == ["scan_shear_drift"]


def lost_share(case: Case) -> float:
    pairs = hidden(case.conditions(), case.effects(), GRID)
    return float(np.mean([item.status != PoiStatus.CONVERGED for pair in pairs for item in pair.maps]))


def test_white_noise_is_a_separate_case_with_the_same_effect_and_existing_keys_stay() -> None:
    usual, white = Case(ONE, ("stage_yaw",), 4.0, 1), Case(ONE, ("stage_yaw",), 4.0, 1, white=True)
    assert usual.key == "5db5da1090e60234" != white.key
    assert white.truth() == usual.truth()
    noise = white.conditions()
    assert (noise.kind, noise.missing, noise.outliers) == (NoiseKind.WHITE, 0.0, 0.0)
    assert (usual.conditions().missing, lost_share(white)) == (0.01, 0.0)
    assert lost_share(usual) == pytest.approx(0.01, rel=0.2)
