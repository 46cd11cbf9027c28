"""Effects of the load cell itself are found from its readings, strain and time; the cells are simulated."""

from __future__ import annotations

import numpy as np
import pytest

from semlive.data.diagnosis.effects import ModelEffect, Outcome
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.diagnose.scalars.load_cell import LoadReadings, add_clock_evidence, add_load_cell_evidence
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.effects.load_cell import FrictionHysteresis, LoadCellDrift, LoadCellZero
from semlive_simulators.specimen.history import History, LoadStep
from semlive_simulators.specimen.specimen import at_rest

NOTHING = Diagnosis(Outcome.NONE, (), (), None, None, None, (), 0.01)
UP = [100.0, 450.0, 800.0, 1150.0, 1500.0, 1850.0, 2200.0]
AND_DOWN = [*UP, 1850.0, 1500.0, 1150.0, 800.0, 450.0, 100.0]
STIFF_N, STRAIN_SIGMA, REST, EVERY_S = 0.711e6, 5e-6, 15, 250.0


def readings(seed: int, effect: Effect | None = None, loads: list[float] = UP, bent_n: float = 0.0, shared: float = 0.0) -> LoadReadings:
    """Fifteen pairs at rest, then the loads; what is read of each is the simulator's, and 0.05 N of noise."""
    rng = np.random.default_rng(seed)
    true_n = np.array([0.0] * REST + loads)
    time_s = EVERY_S * np.arange(len(true_n))
    changes = np.diff(true_n, prepend=0.0)
    history = History(tuple(LoadStep(float(at), float(by)) for at, by in zip(time_s, changes, strict=True) if by), ())
    read = [
        entry if effect is None else effect.load_reading_n(entry, float(at), at_rest((0.0, 0.0), np.zeros((2, 2)), entry, history))
        for entry, at in zip(true_n.tolist(), time_s, strict=True)
    ]
    load_n = np.array(read) + 0.05 * rng.standard_normal(len(true_n))
    loaded = np.arange(len(true_n)) >= REST
    strain = true_n / STIFF_N + bent_n * (true_n / 2200.0) ** 2 / STIFF_N + STRAIN_SIGMA * rng.standard_normal(len(true_n))
    strain += shared * rng.standard_normal()
    way = np.where(loaded, np.sign(changes), 0.0)
    covariance = np.outer(loaded, loaded) * shared**2 + np.diag(np.where(loaded, STRAIN_SIGMA**2, 0.0))
    return LoadReadings(time_s, load_n, np.where(loaded, strain, 0.0), covariance, loaded, way, 441.5)


@pytest.mark.parametrize("bent_n", [0.0, 40.0])
def test_a_cell_that_reads_what_there_is_has_no_effect(bent_n: float) -> None:
    found = [add_load_cell_evidence(NOTHING, readings(seed, loads=loads, bent_n=bent_n)) for seed in range(100) for loads in (UP, AND_DOWN)]
    assert sum(bool(entry.effects) for entry in found) == 0
    assert np.mean([entry.where[-1].p_value < 0.05 for entry in found]) < 0.09


def test_a_common_strain_offset_is_no_friction() -> None:
    found = [add_load_cell_evidence(NOTHING, readings(seed, shared=2e-5)) for seed in range(100)]
    assert sum(bool(entry.effects) for entry in found) == 0


def test_friction_in_one_direction_only_is_not_separable_from_a_step() -> None:
    """The first load step is zero as well: no way, and not the other one."""
    found = add_load_cell_evidence(NOTHING, readings(1, FrictionHysteresis(60.0), [0.0, *UP]))
    assert (found.outcome, found.ambiguous) == (Outcome.AMBIGUOUS, ("friction_hysteresis", "refocus_magnification_step"))


@pytest.mark.parametrize(
    ("effect", "loads", "true", "outcome"),
    [
        (LoadCellDrift(0.002), UP, 0.002, Outcome.IDENTIFIED),
        (LoadCellZero(20.0), UP, 20.0, Outcome.AMBIGUOUS),
        (FrictionHysteresis(15.0), AND_DOWN, 15.0, Outcome.IDENTIFIED),
        (FrictionHysteresis(60.0), UP, 60.0, Outcome.AMBIGUOUS),
    ],
)
def test_what_a_cell_does_has_a_name(effect: Effect, loads: list[float], true: float, outcome: Outcome) -> None:
    found = [add_load_cell_evidence(NOTHING, readings(seed, effect, loads)) for seed in range(40)]
    assert all(entry.outcome is outcome and [item.name for item in entry.effects] == [effect.name] for entry in found)
    gaps = [entry.gap for entry in found if entry.gap is not None]
    assert len(gaps) == len(found)
    assert np.median([entry.closure for entry in gaps]) == pytest.approx(1.0, abs=0.05)
    away = [(item.value - true) / item.sigma for entry in found for item in entry.effects[0].parameters]
    assert abs(np.mean(away)) < 0.5
    assert np.std(away) == pytest.approx(1.0, abs=0.4)


def test_a_load_that_relaxes_is_no_drift_of_its_zero_alone() -> None:
    at_rest_n = readings(1)
    relaxing = LoadReadings(
        at_rest_n.time_s, at_rest_n.load_n + np.where(at_rest_n.loaded, 0.0, 100.0 - 0.002 * at_rest_n.time_s),
        at_rest_n.strain, at_rest_n.strain_covariance, at_rest_n.loaded, at_rest_n.loading_direction, at_rest_n.half_px,
    )  # fmt: skip
    found = add_load_cell_evidence(NOTHING, relaxing)
    assert found.outcome is not Outcome.IDENTIFIED
    assert all(entry.name in ("load_cell_zero", "load_cell_drift", "friction_hysteresis") for entry in found.effects)


def test_what_the_model_has_is_not_named_again() -> None:
    with_drift = Diagnosis(Outcome.NONE, (), (), None, None, None, (), 0.01, model_effects=(ModelEffect("load_cell_drift", (), 7.0),))
    assert add_load_cell_evidence(with_drift, readings(1, LoadCellDrift(0.002))).effects == ()


def test_a_clock_that_is_wrong_beyond_what_exporting_takes_has_a_name() -> None:
    right = add_clock_evidence(NOTHING, 5.0, 2.1)
    assert right.outcome is Outcome.NONE
    assert right.effects == ()
    wrong = add_clock_evidence(NOTHING, -25.0, 2.1)
    assert wrong.outcome is Outcome.IDENTIFIED
    assert [(entry.name, entry.parameters[0].value) for entry in wrong.effects] == [("timestamp_offset", -25.0)]
