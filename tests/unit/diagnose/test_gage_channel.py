"""A gage separates a specimen that is lifted with the load from strain; lift and gage factor are simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from semlive.data.diagnosis.effects import IdentifiedEffect, ModelEffect, Outcome
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.data.experiment import Phase
from semlive.data.strain import MeasuredValue
from semlive.diagnose.baseline.observation import StepConditions
from semlive.diagnose.scalars.load_cell import LoadReadings, add_load_cell_evidence
from semlive.diagnose.scalars.strain_gage import GageReadings, add_gage_evidence, gage_readings
from semlive_simulators.effects.deformation import OutOfPlaneTranslation

NOTHING = Diagnosis(Outcome.NONE, (), (), None, None, None, (), 0.01)
UP = [100.0, 450.0, 800.0, 1150.0, 1500.0, 1850.0, 2200.0]
STIFF_N, STRAIN_SIGMA, GAGE_SIGMA, REST, EVERY_S = 0.711e6, 5e-6, 1e-7, 15, 250.0
DEFAULT = OutOfPlaneTranslation.defaults("x200")
LIFT = DEFAULT.lift_um_per_n / (1e3 * DEFAULT.working_distance_mm)
HALF_PX = 441.5


def readings(
    seed: int,
    per_n: float = 0.0,
    factor: float | None = None,
    zero: float = 0.0,
    step: float = 0.0,
    scatter: float = 0.0,
    drift_per_s: float = 0.0,
    loads: list[float] = UP,
) -> GageReadings:
    """Fifteen stationary pairs, then the loads. All loads share the uncertainty of frame 0 (1e-5); the factor is drawn with its 0.5 %.

    Args:
        seed: of all noise.
        per_n: apparent strain of a lift.
        factor: what the gage's is; None draws it.
        zero: of the gage.
        step: strain that only maps show, equal at all loads.
        scatter: standard deviation of what the maps add in each loaded pair by themselves.
        drift_per_s: of the gage.
        loads: that were held.
    """
    rng = np.random.default_rng(seed)
    load_n = np.array([0.0] * REST + loads)
    loaded = np.arange(len(load_n)) >= REST
    time_s = EVERY_S * np.arange(len(load_n))
    drawn = 1.0 + 0.005 * rng.standard_normal() if factor is None else factor
    strain = load_n / STIFF_N + per_n * load_n + step + 1e-5 * rng.standard_normal()
    strain += (STRAIN_SIGMA + scatter) * rng.standard_normal(len(load_n))
    gage = drawn * load_n / STIFF_N + zero + drift_per_s * time_s + GAGE_SIGMA * rng.standard_normal(len(load_n))
    covariance = np.outer(loaded, loaded) * 1e-10 + np.diag(np.where(loaded, STRAIN_SIGMA**2, 0.0))
    way = np.where(loaded, 1.0, 0.0)
    read_n = load_n + 0.05 * rng.standard_normal(len(load_n))
    load_readings = LoadReadings(time_s, read_n, np.where(loaded, strain, 0.0), covariance, loaded, way, HALF_PX)
    return GageReadings(load_readings, gage, np.full(len(load_n), GAGE_SIGMA), 0.005)


def named(found: list[Diagnosis]) -> int:
    return sum(any(entry.name == "out_of_plane_translation" for entry in verdict.effects) for verdict in found)


def test_maps_that_show_what_the_gage_shows_have_no_lift() -> None:
    found = [add_gage_evidence(NOTHING, readings(seed)) for seed in range(400)]
    assert named(found) == 0
    assert all(entry.outcome is Outcome.NONE for entry in found)
    assert np.mean([entry.where[-1].p_value < 0.05 for entry in found]) < 0.09


@pytest.mark.parametrize(("per_n", "least"), [(LIFT, 40), (-LIFT, 40), (0.5 * LIFT, 40), (0.25 * LIFT, 20)])
def test_a_lift_has_a_name(per_n: float, least: int) -> None:
    found = [add_gage_evidence(NOTHING, readings(seed, per_n)) for seed in range(40)]
    assert named(found) >= least
    identified = [entry for entry in found if entry.effects]
    assert all((entry.outcome, entry.group, entry.ambiguous) == (Outcome.IDENTIFIED, "G6", ()) for entry in identified)
    assert all(entry.effects[0].strain for entry in identified)
    values = [{item.name: item for item in entry.effects[0].parameters} for entry in identified]
    away = [(entry["strain_per_n"].value - per_n) / entry["strain_per_n"].sigma for entry in values]
    if least == len(found):  # those that are significant by chance are too large
        assert abs(np.mean(away)) < 0.5
        assert np.std(away) == pytest.approx(1.0, abs=0.3)
        assert np.median([entry.gap.closure for entry in found if entry.gap is not None]) == pytest.approx(1.0, abs=0.05)
        assert values[0]["size_px"].value == pytest.approx(abs(per_n) * 2200.0 * HALF_PX, rel=0.1)
        # The maps' modulus is E / (1 + k E A).
        assert np.mean([entry["modulus_change"].value for entry in values]) == pytest.approx(per_n * STIFF_N, rel=0.05)


@pytest.mark.parametrize(
    "readings_error",
    [
        {"factor": 1.005},
        {"factor": 0.995},
        {"factor": 1.01},
        {"zero": 3e-4},
        {"zero": -3e-4, "factor": 1.005},
        {"step": 2e-4},
        {"scatter": 1e-4},
        {"drift_per_s": 2e-8},
    ],
)
def test_what_a_gage_or_a_first_step_does_is_no_lift(readings_error: dict[str, float]) -> None:
    assert named([add_gage_evidence(NOTHING, readings(seed, **readings_error)) for seed in range(100)]) == 0


def test_scatter_between_loads_is_reported_without_a_name() -> None:
    found = [add_gage_evidence(NOTHING, readings(seed, scatter=1e-4)) for seed in range(100)]
    received = [entry.where[-1] for entry in found]
    assert all(entry.domain == "gage_readings" for entry in received)
    assert sum(entry.p_value < 0.01 for entry in received) >= 95
    # Seven values scatter about their own mean by 0.93 of that.
    assert np.median([entry.rms_px for entry in received]) == pytest.approx(0.97e-4 * HALF_PX, rel=0.25)
    assert all(entry.outcome is Outcome.NONE for entry in found)


@pytest.mark.parametrize("name", ["bending_misalignment", "magnification_drift"])
@pytest.mark.parametrize("in_model", [False, True])
def test_an_effect_that_also_separates_maps_and_gage_stays_ambiguous(name: str, in_model: bool) -> None:
    law = ModelEffect(name, (), 0.1)
    effect = IdentifiedEffect(name, (), 0.1, 20.0, 0.003, False, law)
    before = (
        replace(NOTHING, model_effects=(law,)) if in_model else replace(NOTHING, outcome=Outcome.IDENTIFIED, effects=(effect,), group="G11")
    )
    found = add_gage_evidence(before, readings(1, LIFT))
    assert (found.outcome, found.ambiguous) == (Outcome.AMBIGUOUS, ("out_of_plane_translation", name))
    assert found.group == "G6"
    assert found.experiment is not None


def test_without_a_gage_or_with_too_few_loads_nothing_changes() -> None:
    assert add_gage_evidence(NOTHING, None) is NOTHING
    assert add_gage_evidence(NOTHING, readings(1, LIFT, loads=UP[:5])) is NOTHING
    silent = readings(1, LIFT)
    assert add_gage_evidence(NOTHING, replace(silent, gage=np.where(silent.load_readings.loaded, np.nan, silent.gage))) is NOTHING
    steps = [StepConditions(at, Phase.TENSION, (1.0, 1.0), (0.0, 0.0)) for at in range(3)]
    assert gage_readings(silent.load_readings, steps, 0.005) is None


def test_pairs_without_a_gage_reading_are_omitted() -> None:
    steps = [
        StepConditions(at, Phase.TENSION, (1.0, 1.0), (0.0, 0.0), gage=None if at == 1 else MeasuredValue(1e-4, 1e-7)) for at in range(3)
    ]
    result = gage_readings(readings(1).load_readings, steps, 0.005)
    assert result is not None
    assert np.isnan(result.gage).tolist() == [False, True, False]


def test_what_the_model_has_is_not_named_again() -> None:
    in_model = replace(NOTHING, model_effects=(ModelEffect("out_of_plane_translation", (), 0.14),))
    assert add_gage_evidence(in_model, readings(1, LIFT)).effects == ()


def test_the_load_cell_reports_what_it_reported() -> None:
    entry = readings(1, LIFT)
    alone = add_load_cell_evidence(NOTHING, entry.load_readings)
    both = add_gage_evidence(alone, entry)
    assert alone.effects == ()
    assert both.where[:-1] == alone.where
    assert both.evidence[:-1] == alone.evidence
