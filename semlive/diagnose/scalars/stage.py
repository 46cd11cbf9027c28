"""Diagnosis of the stage: commanded moves against the fitted shifts of the maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import DomainTest, IdentifiedEffect, ModelEffect, Outcome, ParameterEstimate
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.data.experiment import Phase
from semlive.diagnose.baseline.observation import Observation, StepConditions
from semlive.diagnose.maps.effect_selection import SIGNIFICANCE_LEVEL, SIGNIFICANT_LOG_FACTOR
from semlive.diagnose.scalars.regression import RegressionTerm, f_test, orthonormal_basis, term
from semlive.model.effects.stage import BACKLASH, MOVES, QUADRATIC, StageEffectClass

Array = NDArray[np.float64]
MIN_MOVE_PX = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class StageMoves:
    """Commanded stage moves and the measured shifts of the image.

    Attributes:
        commanded_px: (n, 2) commanded positions, px.
        fitted_px: (n, 2) fitted shifts of the image, px.
    """

    commanded_px: Array
    fitted_px: Array

    @property
    def direction(self) -> Array:
        """(n, 2) sign of the last move along each axis, 0 before the first."""
        signs = np.sign(np.diff(self.commanded_px, axis=0, prepend=self.commanded_px[:1]))
        for at in range(1, len(signs)):
            signs[at] = np.where(signs[at] == 0.0, signs[at - 1], signs[at])
        return signs


def stage_moves(observation: Observation, steps: Sequence[StepConditions]) -> StageMoves:
    """Moves of pairs without load; a load shifts the specimen."""
    solution = observation.solution
    motions = solution.state.motions
    unloaded = [step for step in steps if step.phase is not Phase.TENSION]
    fitted = [motions.shift_and_gradient(step.pair, solution.part("motion"))[0] for step in unloaded]
    return StageMoves(np.array([step.shift_px for step in unloaded]).reshape(-1, 2), np.array(fitted).reshape(-1, 2))


def add_stage_evidence(verdict: Diagnosis, moves: StageMoves) -> Diagnosis:
    """Add the evidence of the stage to a verdict.

    Scale and angle of the stage are not effects, because they are equivalent to those of the image; the estimate reports them. Drift
    between pairs is modelled as a parabola in time. Backlash and a position-dependent scale are each tested jointly with the other.
    """
    already = {model_effect.name for model_effect in (*verdict.model_effects, *verdict.effects)}
    tests = {family.name: _test(moves, family) for family in MOVES}
    valid_tests = {name: test for name, test in tests.items() if test is not None}
    if not valid_tests:
        return verdict
    p_value = min(1.0, len(valid_tests) * min(test.p_value for test in valid_tests.values()))
    rms_px = max(float(np.sqrt(np.mean(test.value_px**2))) for test in valid_tests.values())
    significant = [
        test for test in valid_tests.values()
        if test.family.name not in already and test.log_factor >= SIGNIFICANT_LOG_FACTOR
        and len(valid_tests) * test.p_value <= SIGNIFICANCE_LEVEL
    ]  # fmt: skip
    effects = tuple(test.effect(len(valid_tests)) for test in significant)
    outcome = Outcome.IDENTIFIED if effects and verdict.outcome is Outcome.NONE else verdict.outcome
    evidence = tuple((name, test.log_factor) for name, test in valid_tests.items())
    where = (*verdict.where, DomainTest("moves", p_value, rms_px))
    return replace(verdict, outcome=outcome, effects=(*verdict.effects, *effects), where=where, evidence=(*verdict.evidence, *evidence))


@dataclass(frozen=True, slots=True, eq=False)
class _Test:
    """Test of one term along both axes."""

    family: StageEffectClass
    value: Array
    sigma: Array
    value_px: Array
    p_value: float
    log_factor: float

    def effect(self, tests: int) -> IdentifiedEffect:
        quantity, unit = ("backlash", "px") if self.family is BACKLASH else ("quadratic", "1/px")
        ending = "_px" if self.family is BACKLASH else "_per_px"
        parameters = tuple(
            ParameterEstimate(f"{quantity}_{axis}{ending}", float(value), float(sigma), unit)
            for axis, value, sigma in zip("xy", self.value, self.sigma, strict=True)
        )
        size_px = float(np.abs(self.value_px).max())
        model_effect = ModelEffect(self.family.name, (), size_px)
        return IdentifiedEffect(self.family.name, parameters, size_px, self.log_factor, min(1.0, tests * self.p_value), False, model_effect)


def _test(moves: StageMoves, family: StageEffectClass) -> _Test | None:
    """F-test of a term along each axis that determines it, jointly with the other term; None if neither axis does."""
    terms = {BACKLASH.name: moves.direction, QUADRATIC.name: moves.commanded_px**2}
    own, other_terms = terms[family.name], [term for name, term in terms.items() if name != family.name]
    value, sigma, value_px = (np.zeros(2) for _ in range(3))
    observed: list[RegressionTerm] = []
    for axis in (0, 1):
        tested = term(own[:, axis], moves.fitted_px[:, axis], _base(moves, [column[:, axis] for column in other_terms]))
        if tested is not None:
            value[axis], sigma[axis] = tested.value, tested.sigma
            value_px[axis] = tested.value * float(np.abs(own[:, axis]).max())
            observed.append(tested)
    result = f_test(observed)
    return None if result is None else _Test(family, value, sigma, value_px, *result)


def _base(moves: StageMoves, more: Sequence[Array]) -> Array:
    """(n, k) orthonormal basis of an offset, both commanded components, drift as a parabola in time, and further terms."""
    late = np.linspace(-1.0, 1.0, len(moves.commanded_px))
    return orthonormal_basis(np.stack([np.ones_like(late), *moves.commanded_px.T, late, late**2, *more], axis=-1), MIN_MOVE_PX * 1e-3)
