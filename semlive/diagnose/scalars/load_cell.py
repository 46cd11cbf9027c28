"""Diagnosis of the load cell: its readings against the strain of the maps and against time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from semlive.data.diagnosis.effects import DomainTest, HeldOutMisfit, IdentifiedEffect, ModelEffect, Outcome, ParameterEstimate
from semlive.data.diagnosis.verdict import Diagnosis, ExperimentProposal
from semlive.data.experiment import Phase
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.observation import Observation, StepConditions
from semlive.diagnose.maps.effect_selection import SIGNIFICANCE_LEVEL, SIGNIFICANT_LOG_FACTOR
from semlive.diagnose.scalars.regression import RegressionTerm, f_test, leave_one_out, orthonormal_basis, term
from semlive.model.effects.load_cell import CLOCK, DRIFT, FRICTION, LOADS, ZERO, LoadEffectClass

Array = NDArray[np.float64]
MIN_RELATIVE_LOAD = 1e-3
"""Smallest reported effect relative to the largest load; accuracy classes of load cells begin at half of this."""
MIN_LOADS_FOR_CURVATURE = 6  # minimum number of loaded pairs for a quadratic term of stress over strain
_CLOCK_SIZE_S = 60.0
_RESAMPLED = 999
_PARAMETERS = {ZERO.name: ("zero_n", "N"), DRIFT.name: ("rate_n_per_s", "N/s"), FRICTION.name: ("friction_n", "N")}


@dataclass(frozen=True, slots=True, eq=False)
class LoadReadings:
    """Load and strain of each pair.

    Attributes:
        time_s: (n,) middle of the pair, since the start of frame 0.
        load_n: (n,) mean reading during the scans, N.
        strain: (n,) mean axial strain since frame 0; 0 for pairs without load.
        strain_covariance: (n, n) covariance of the strain; the part by frame 0 and the distortion is common to all loads.
        loaded: (n,) whether the specimen was under load.
        loading_direction: (n,) sign of the last change of the load, 0 before the first.
        half_px: half of the frame size along the load, px.
    """

    time_s: Array
    load_n: Array
    strain: Array
    strain_covariance: Array
    loaded: NDArray[np.bool_]
    loading_direction: Array
    half_px: float

    @property
    def largest_n(self) -> float:
        """The largest reading, N."""
        return float(np.abs(self.load_n).max(initial=0.0))


def load_readings(
    observation: Observation, steps: Sequence[StepConditions], loading_axis: str, with_effects: HyperparameterGrid | None = None
) -> LoadReadings:
    """Load readings of all pairs of a run with the load along the image axis `loading_axis`.

    Args:
        observation: observation of the run.
        steps: steps of the plan.
        loading_axis: x or y.
        with_effects: baseline with the effects of the maps, whose strain is then not part of the strain; without it the strain is that of
            the estimate. A row time wrong by 25 % is a strain of 1e-4 with a drift of 0.008 px/s, and was a friction of 79 N before.
    """
    solution = observation.solution
    state, axis = solution.state, "xy".index(loading_axis)
    time_s = np.array([0.5 * sum(state.frame_time(2 * step.pair + member).start_s for member in (0, 1)) for step in steps])
    load_n = np.array([0.5 * sum(step.load_n) for step in steps])
    loaded = np.array([step.phase is Phase.TENSION for step in steps])
    rows, first = np.zeros((len(steps), len(solution.mean))), state.layout.part("motion").start
    for at, step in enumerate(steps):
        if step.phase is Phase.TENSION and step.pair in state.motions.pairs:
            rows[at, first + state.motions.part(step.pair)[0].start + (1, 5)[axis]] = 1.0
    mean, covariance = (solution.mean, solution.covariance_of(rows)) if with_effects is None else _with_effects(with_effects, rows)
    strain, half_px = rows @ mean, float(state.centre_px[axis])
    return LoadReadings(time_s, load_n, strain, covariance, loaded, _loading_directions(load_n, loaded), half_px)


def _with_effects(grid: HyperparameterGrid, rows: Array) -> tuple[Array, Array]:
    """(n,) parameters of the estimate, fitted jointly with effects, and (k, k) covariance of k linear functions (k, n) of them."""
    at, best = grid.design.parameter_indices, grid.best
    mean, own = grid.design.observation.solution.mean.copy(), np.zeros((grid.design.size, len(rows)))
    mean[at] += best.solve(best.gradient[:, None])[: len(at), 0]
    own[: len(at)] = rows[:, at].T
    half = best.half(own)
    return mean, half.T @ half


def _loading_directions(load_n: Array, loaded: NDArray[np.bool_]) -> Array:
    """(n,) sign of the last load step; changes between two pairs of one step do not count."""
    direction, last = np.zeros(len(load_n)), 0.0
    for at in range(1, len(load_n)):
        change = load_n[at] - load_n[at - 1]
        if (loaded[at] or loaded[at - 1]) and abs(change) > 0.01 * np.abs(load_n).max():
            last = float(np.sign(change))
        direction[at] = last
    return direction


def add_load_cell_evidence(verdict: Diagnosis, readings: LoadReadings) -> Diagnosis:
    """Add the evidence of the load cell to a verdict.

    Without load, the readings are the zero of the cell and its drift. Under load, they are a linear function of strain, or a quadratic one
    if there are enough loads, with the same zero. Zero, drift and friction are each tested jointly with the others.
    """
    already = {model_effect.name for model_effect in (*verdict.model_effects, *verdict.effects)}
    tests = {family.name: _test(readings, family) for family in LOADS}
    valid_tests = {name: test for name, test in tests.items() if test is not None}
    if not valid_tests:
        return verdict
    p_value = min(1.0, len(valid_tests) * min(test.p_value for test in valid_tests.values()))
    significant = [
        test for test in valid_tests.values()
        if test.family.name not in already
        and test.log_factor >= SIGNIFICANT_LOG_FACTOR
        and len(valid_tests) * test.p_value <= SIGNIFICANCE_LEVEL
        and test.matters
    ]  # fmt: skip
    where = (*verdict.where, DomainTest("load_readings", p_value, max(test.size_px for test in valid_tests.values())))
    evidence = tuple((name, test.log_factor) for name, test in valid_tests.items())
    merged = replace(verdict, where=where, evidence=(*verdict.evidence, *evidence))
    merged = replace(merged, gap=merged.gap or _gap(readings, [test.family.name for test in significant]))
    return merge_effects(
        merged,
        [test.effect(len(valid_tests)) for test in significant],
        [test.rivals for test in significant],
        [test.family for test in significant],
    )


def load_offsets(readings: LoadReadings, names: Sequence[str]) -> dict[str, Array]:
    """(n,) fitted contribution of load cell effects to the readings by name, N; unobservable effects are left out."""
    own, _ = _columns(readings)
    valid_tests = {family.name: _test(readings, family) for family in LOADS if family.name in names}
    return {name: test.term.value * own[name] for name, test in valid_tests.items() if test is not None}


def add_clock_evidence(verdict: Diagnosis, offset_s: float, sigma_s: float) -> Diagnosis:
    """Add the evidence of the microscope's clock: its offset from the configured one and the standard uncertainty, s."""
    if CLOCK.name in {model_effect.name for model_effect in verdict.model_effects}:
        return verdict
    visible = (_CLOCK_SIZE_S / sigma_s) ** 2
    odds = 0.5 * (offset_s / sigma_s) ** 2 * visible / (1.0 + visible) - 0.5 * math.log1p(visible)
    p_value = math.erfc(abs(offset_s) / sigma_s / math.sqrt(2.0))
    merged = replace(verdict, evidence=(*verdict.evidence, (CLOCK.name, odds)))
    if odds < SIGNIFICANT_LOG_FACTOR or p_value > SIGNIFICANCE_LEVEL:
        return merged
    parameters = (ParameterEstimate("offset_s", offset_s, sigma_s, "s"),)
    effect = IdentifiedEffect(CLOCK.name, parameters, 0.0, odds, p_value, False, ModelEffect(CLOCK.name, (), abs(offset_s)))
    return merge_effects(merged, [effect], [()], [CLOCK])


def merge_effects(
    verdict: Diagnosis, effects: list[IdentifiedEffect], rivals: list[tuple[str, ...]], families: list[LoadEffectClass]
) -> Diagnosis:
    """Add effects of scalar readings; an outcome other than NONE or IDENTIFIED remains."""
    verdict = replace(verdict, effects=(*verdict.effects, *effects))
    undecided = next((at for at, rival in enumerate(rivals) if rival), None)
    if not effects or verdict.outcome not in (Outcome.NONE, Outcome.IDENTIFIED):
        return verdict
    if undecided is None:
        return replace(verdict, outcome=Outcome.IDENTIFIED, group=verdict.group or families[0].group)
    names = (effects[undecided].name, *rivals[undecided])
    proposal = ExperimentProposal(names, families[undecided].discriminating_experiment)
    return replace(verdict, outcome=Outcome.AMBIGUOUS, ambiguous=names, group=families[undecided].group, experiment=proposal)


@dataclass(frozen=True, slots=True, eq=False)
class _Test:
    """Test of one term of the readings."""

    family: LoadEffectClass
    term: RegressionTerm
    p_value: float
    log_factor: float
    size_n: float
    size_px: float
    matters: bool
    rivals: tuple[str, ...]

    def effect(self, tests: int) -> IdentifiedEffect:
        name, unit = _PARAMETERS[self.family.name]
        parameters = (ParameterEstimate(name, self.term.value, self.term.sigma, unit),)
        model_effect = ModelEffect(self.family.name, (), self.size_n)
        return IdentifiedEffect(self.family.name, parameters, 0.0, self.log_factor, min(1.0, tests * self.p_value), False, model_effect)


def _test(readings: LoadReadings, family: LoadEffectClass) -> _Test | None:
    """F-test of a term jointly with the others; None if the readings do not determine it."""
    own, base = _columns(readings)
    if family.name not in own or not readings.largest_n > 0.0:
        return None
    stiffness_n, covariance = _scales(readings)
    factor = np.linalg.cholesky(covariance)
    other_columns = [column for name, column in own.items() if name != family.name]
    columns = np.stack([*base, *other_columns, np.zeros(len(factor)), own[family.name], readings.load_n], axis=-1)
    white = solve_triangular(factor, columns, lower=True)
    tested = limit_precision(term(white[:, -2], white[:, -1], orthonormal_basis(white[:, :-2], 1e-12)))
    result = None if tested is None else f_test([tested])
    if tested is None or result is None:
        return None
    size_n = abs(tested.value) * float(np.ptp(own[family.name])) if family is DRIFT else abs(tested.value)
    size_px = size_n / stiffness_n * readings.half_px if stiffness_n > 0.0 else 0.0
    matters = size_n > MIN_RELATIVE_LOAD * readings.largest_n
    return _Test(family, tested, *result, size_n, size_px, matters, _rivals(readings, family, tested))


def limit_precision(tested: RegressionTerm | None) -> RegressionTerm | None:
    """The term with an uncertainty of at least that of the readings; exactly constant readings do not make it more precise."""
    if tested is None or tested.residual_ss >= tested.degrees_of_freedom:
        return tested
    variance_ratio = math.sqrt(tested.degrees_of_freedom / max(tested.residual_ss, 1e-30))
    return replace(tested, sigma=tested.sigma * variance_ratio, residual_ss=float(tested.degrees_of_freedom))


def _columns(readings: LoadReadings) -> tuple[dict[str, Array], list[Array]]:
    """Columns of the readings: of each effect by name, and of the baseline without effects."""
    loaded = readings.loaded.astype(np.float64)
    own = {ZERO.name: np.ones(len(loaded)), DRIFT.name: readings.time_s - readings.time_s[0]}
    if not loaded.any():
        return own, []
    base = [loaded * readings.strain]
    if int(loaded.sum()) >= MIN_LOADS_FOR_CURVATURE:
        base.append(loaded * readings.strain**2)
    if bool(np.any(~readings.loaded)) or np.ptp(readings.loading_direction[readings.loaded]) > 0.0:
        own[FRICTION.name] = readings.loading_direction
    return own, base


def _scales(readings: LoadReadings) -> tuple[float, Array]:
    """Stiffness of the specimen, N per unit strain, and the (n, n) covariance of the readings relative to the strain.

    Readings scatter like unloaded ones about their line, and under load also by the uncertainty of the strain. That uncertainty is partly
    common to all loads: without this a run with a common strain error was identified as friction.
    """
    baseline, loaded = ~readings.loaded, readings.loaded
    unloaded_sigma_n = 1e-3 * max(readings.largest_n, 1e-6)
    if int(baseline.sum()) > 3:
        line = np.polynomial.Polynomial.fit(readings.time_s[baseline], readings.load_n[baseline], 1)
        residual = readings.load_n[baseline] - line(readings.time_s[baseline])
        unloaded_sigma_n = max(float(np.sqrt(residual @ residual / (int(baseline.sum()) - 2))), 1e-6 * max(readings.largest_n, 1e-6))
    stiffness_n = 0.0
    if loaded.any() and np.ptp(readings.strain[loaded]) > 0.0:
        stiffness_n = float(np.polyfit(readings.strain[loaded], readings.load_n[loaded], 1)[0]) if int(loaded.sum()) > 1 else 0.0
    return stiffness_n, unloaded_sigma_n**2 * np.eye(len(readings.load_n)) + stiffness_n**2 * readings.strain_covariance


def _gap(readings: LoadReadings, names: list[str]) -> HeldOutMisfit | None:
    """Misfit of each reading predicted from all others, without and with the effects, as displacement at the edge of the frame."""
    own, base = _columns(readings)
    stiffness_n, covariance = _scales(readings)
    sigma_n = np.sqrt(np.diag(covariance))
    if not names or not base or stiffness_n <= 0.0:
        return None
    required = (base, [*base, *(own[name] for name in names)])
    (before, _), (after, variance_ratio) = (
        leave_one_out(readings.load_n / sigma_n, orthonormal_basis(np.stack(value, axis=-1) / sigma_n[:, None], 1e-12))
        for value in required
    )
    return score_prediction(before, after, variance_ratio, sigma_n / stiffness_n * readings.half_px)


def score_prediction(before: Array, after: Array, variance_ratio: Array, px: Array) -> HeldOutMisfit:
    """Held-out misfit of readings that are each predicted from all others.

    Args:
        before: (n,) prediction error without the effects, in standard uncertainties of the reading.
        after: (n,) prediction error with the effects.
        variance_ratio: (n,) variance of the prediction error by noise, relative to that of a reading.
        px: (n,) displacement equivalent to the standard uncertainty of each reading, px.
    """
    squares = np.stack([(before * px) ** 2, (after * px) ** 2, variance_ratio * px**2])
    n = squares.shape[1]
    samples = squares[:, np.random.default_rng(0).integers(n, size=(_RESAMPLED, n))].mean(axis=2)
    low, high = np.quantile((samples[0] - samples[1]) / np.maximum(samples[0] - samples[2], 1e-30), (0.025, 0.975)).tolist()
    before_power, residual, floor = squares.mean(axis=1).tolist()
    gained = squares[0] - squares[1]
    gain_in_sigmas = float(gained.mean() / max(gained.std() / math.sqrt(n), 1e-30))
    closure = (before_power - residual) / max(before_power - floor, 1e-30)
    return HeldOutMisfit(math.sqrt(before_power), math.sqrt(residual), math.sqrt(floor), closure, (low, high), gain_in_sigmas)


def _rivals(readings: LoadReadings, family: LoadEffectClass, tested: RegressionTerm) -> tuple[str, ...]:
    """Names of other effects that explain the same readings."""
    if family is FRICTION and {-1.0, 1.0} <= set(readings.loading_direction[readings.loaded].tolist()):
        return ()
    if family is DRIFT:
        baseline = ~readings.loaded
        unloaded_mean_n = float(np.mean(readings.load_n[baseline])) if baseline.any() else 0.0
        lost_n = -tested.value * float(np.ptp(readings.time_s)) * math.copysign(1.0, unloaded_mean_n)
        # An existing load can relax by a part of itself.
        return ("creep_in_hold",) if 0.0 < lost_n < 0.5 * abs(unloaded_mean_n) else ()
    return family.rivals
