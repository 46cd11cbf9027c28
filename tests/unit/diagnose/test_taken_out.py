"""A run with a model: effects that can be fitted are corrected; otherwise the run continues uncorrected and reports the reason."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from blind.experiment import AREA_MM2, YOUNGS_GPA, Conditions, HiddenPair, hidden
from blind.hiding import hidden_effect
from blind.live import decided, followed
from blind.observing import QUICK
from numexp.asrun import START_NS
from threadpoolctl import threadpool_limits

from semlive import pipeline
from semlive.data.diagnosis.effects import EffectModel, ModelEffect
from semlive.data.grid import Grid
from semlive.data.pair import PairDecision
from semlive.data.results import FrameResult
from semlive.data.settings import AnalysisSettings, EstimateSettings, SpecimenSettings
from semlive.errors import IllPosed
from semlive.estimate.joint.observations import accumulation
from semlive.pipeline import effect_correction
from semlive_simulators.effects.charging import ChargingLocalLens

GRID = Grid(101, 101, 50, 15, 12, 43)  # a block is a point
COARSE = Grid(101, 101, 45, 17, 14, 43)
FINE = Grid(101, 101, 25, 30, 24, 43)
STEADY = EstimateSettings(drift_knots_per_frame=1.0)  # the drift is quadratic, and fewer knots take a third of the time
SMOOTH = EstimateSettings(drift_knots_per_frame=1.0, distortion_knot_px=150.0)
NAME = "charging_local_lens"
PEAK_PX = 0.2
EFFECT = (ChargingLocalLens(PEAK_PX, 80.0, 0.0, 900.0, ((560.0, 330.0),)),)
MODEL = EffectModel((ModelEffect(NAME, (("x_px", 560.0 - 511.5), ("y_px", 330.0 - 441.5), ("width_px", 80.0)), 0.2),))
Steps = list[tuple[pipeline.AnalysisState, pipeline.PairResult]]


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """As in the daemon's analysis; two threads for such small matrices wait for one another."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.fixture(scope="module")
def charging() -> list[HiddenPair]:
    """Six pairs with a spot that charges by far more than the noise."""
    return hidden(Conditions(911, calibration=6, tension=0, noise_px=0.005), EFFECT, GRID)


@pytest.fixture(scope="module")
def without_model(charging: list[HiddenPair]) -> Steps:
    """Without a model."""
    return list(followed(charging, AnalysisSettings(estimate=SMOOTH)))


@pytest.fixture(scope="module")
def uncorrected_field(without_model: Steps) -> np.ndarray:
    """Displacement in the last frame without a model."""
    return last_field(without_model[-1][0])


@pytest.fixture(scope="module")
def modelled(charging: list[HiddenPair]) -> Steps:
    """With one."""
    return list(followed(charging, AnalysisSettings(estimate=SMOOTH, model=MODEL)))


def field_of(frame: FrameResult) -> np.ndarray:
    """(n, 2) displacement where it is valid."""
    shown = frame.displacement
    return np.stack((shown.u_px[shown.valid], shown.v_px[shown.valid]), axis=-1)


def last_field(state: pipeline.AnalysisState) -> np.ndarray:
    """The same of the last frame, at the end."""
    return field_of(pipeline.finalise(state).frames[-1])


def roughness(frame: FrameResult) -> float:
    """Nothing was strained: scatter of a displacement over the points, px."""
    return float(np.sqrt(np.var(field_of(frame), axis=0).sum()))


def test_results_after_each_pair_are_corrected_for_the_effect(modelled: Steps, without_model: Steps) -> None:
    assert [any(f"{NAME} taken out" in note.text for note in result.estimate.notes) for _, result in modelled] == [False] * 4 + [True] * 2
    assert "yet: 4 pairs with" in modelled[3][1].estimate.notes[-1].text
    with_it, without = (roughness(printed[-1][1].frames[1]) for printed in (without_model, modelled))
    assert without < 0.5 * with_it


def test_the_end_is_that_of_all_pairs_at_once(charging: list[HiddenPair], modelled: Steps) -> None:
    *_, state = pipeline.follow(AnalysisSettings(estimate=SMOOTH, model=MODEL), ((decided(pair), pair.maps) for pair in charging))
    assert np.array_equal(last_field(modelled[-1][0]), last_field(pipeline.apply_effect_model(state)))


def test_a_run_with_a_pause_is_corrected_with_fewer_drift_knots(
    monkeypatch: pytest.MonkeyPatch, charging: list[HiddenPair], modelled: Steps
) -> None:
    """Live and at the end: how long a restart took, which was the load of the computer, decides nothing."""
    monkeypatch.setattr(accumulation, "DENSE_KNOTS", 24)  # of the 30 that the run has
    printed = list(followed(charging, AnalysisSettings(estimate=SMOOTH, model=MODEL)))
    assert any(f"{NAME} taken out" in note.text for note in printed[-1][1].estimate.notes)
    *_, state = pipeline.follow(AnalysisSettings(estimate=SMOOTH, model=MODEL), ((decided(pair), pair.maps) for pair in charging))
    assert np.array_equal(last_field(printed[-1][0]), last_field(pipeline.apply_effect_model(state)))
    for frame in (10, 11):
        given, complete = (each[-1][0].model_correction.displacement_by_frame[frame] for each in (printed, modelled))
        assert np.sqrt(np.mean((given - complete) ** 2)) < 0.02 * np.sqrt(np.mean(complete**2))


def test_no_frame_is_reported_again_for_strain_that_only_changed_its_name(modelled: Steps) -> None:
    before, (state, result) = modelled[3][0].reported, modelled[4]
    sigma = max(item.summary.mean_sigma.eyy for item in state.reported.values())
    # What magnification and distortion had of the spot before, the effect has now.
    assert state.model_correction.strain_of(7).eyy > 20.0 * sigma
    for item in result.revised_frames:
        old = before[item.summary.frame].summary
        moved = [abs(getattr(item.summary.mean, of) - getattr(old.mean, of)) / getattr(old.mean_sigma, of) for of in ("exx", "eyy", "exy")]
        assert max(moved) > 0.9


def test_a_run_with_another_frame_size_continues_without_the_model(charging: list[HiddenPair], uncorrected_field: np.ndarray) -> None:
    settings = AnalysisSettings(estimate=SMOOTH, model=EffectModel(MODEL.effects, size_px=(512, 442)))
    *_, state = pipeline.follow(settings, ((decided(pair), pair.maps) for pair in charging))
    state = pipeline.apply_effect_model(state)
    (note,) = state.model_correction.notes
    assert note.message.startswith("WARNING: model: nothing is taken out of the maps: it was found in frames of 512 x 442 px")
    assert np.array_equal(last_field(state), uncorrected_field)


def test_what_the_load_cell_does_by_itself_is_taken_off_the_loads() -> None:
    pairs = hidden(Conditions(912, calibration=6, tension=6, noise_px=0.005), (), FINE)
    specimen = SpecimenSettings(area_mm2=AREA_MM2)
    moduli = {}
    for name, effects in (("as read", ()), ("without drift", (ModelEffect("load_cell_drift", (), 10.0),))):
        settings = AnalysisSettings(specimen=specimen, estimate=STEADY, model=EffectModel(effects))
        *_, state = pipeline.follow(settings, ((drifting(decided(pair), 0.02), pair.maps) for pair in pairs))
        result = pipeline.finalise(pipeline.apply_effect_model(state))
        assert result.elastic is not None
        moduli[name] = result.elastic.youngs_modulus_gpa
        printed = [note for note in result.messages if "load_cell_drift" in note] if effects else []
        assert not effects or "taken off the loads" in printed[0]
    assert abs(moduli["as read"].value - YOUNGS_GPA) > 5.0 * moduli["as read"].sigma
    assert abs(moduli["without drift"].value - YOUNGS_GPA) < 3.0 * moduli["without drift"].sigma


def test_strain_that_an_effect_of_the_maps_adds_is_no_error_of_the_load_cell() -> None:
    """An aspect ratio that drifts by 4e-4 adds a strain of as much, which was a friction of 136 N with loads of up to 2.1 kN."""
    pairs = hidden(Conditions(509, calibration=6, tension=4), hidden_effect("aspect_drift", 0.2, 1), COARSE)
    measured = [effect_correction.MeasuredPair(decided(pair), pair.times, pair.maps) for pair in pairs]
    model = EffectModel((ModelEffect("aspect_drift", (), 0.2), ModelEffect("friction_hysteresis", (), 10.0)))
    correction = effect_correction.fit_effect_correction(model, QUICK, "y", measured)
    assert any("friction_hysteresis" in note.message for note in correction.notes)
    assert max(abs(correction.load_of(pair.pose.pair)) for pair in pairs) < 30.0


def drifting(decision: PairDecision, rate_n_s: float) -> PairDecision:
    """Read with a load cell whose zero wanders."""
    assert decision.loads is not None
    more_n = [rate_n_s * item.start_time_ns.value / 1e9 - rate_n_s * START_NS / 1e9 for item in (decision.first, decision.second)]
    loads = [replace(item, mean_n=item.mean_n + more) for item, more in zip(decision.loads, more_n, strict=True)]
    return replace(decision, loads=(loads[0], loads[1]))


def test_more_pairs_than_can_be_fitted_continue_without_the_model(
    monkeypatch: pytest.MonkeyPatch, charging: list[HiddenPair], uncorrected_field: np.ndarray, modelled: Steps
) -> None:
    monkeypatch.setattr(effect_correction, "MAX_PAIRS", 5)
    state, result = pipeline.add_pair(modelled[4][0], decided(charging[5]), charging[5].maps)
    assert result.estimate.notes[-1].message.startswith("WARNING: model: nothing is taken out of the maps: 6 pairs are more than the 5")
    assert np.array_equal(last_field(state), uncorrected_field)


def test_a_run_continues_uncorrected_where_the_fit_is_not_possible(
    charging: list[HiddenPair], uncorrected_field: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such a pair was refused, which stopped the run."""

    def refuse(*_: object) -> None:
        raise IllPosed("its equations are singular")

    monkeypatch.setattr(effect_correction, "effect_displacement", refuse)
    *_, (state, _) = followed(charging, AnalysisSettings(estimate=SMOOTH, model=MODEL))
    assert "model: nothing is taken out of the maps yet: its equations are singular" in [note.text for note in state.model_correction.notes]
    np.testing.assert_array_equal(last_field(state), uncorrected_field)
