"""The stage's channel: commanded moves against those that maps were fitted with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis import Diagnosis, DomainTest, IdentifiedEffect, ModelEffect, Outcome, ParameterEstimate
from semlive.data.experiment import Phase
from semlive.diagnose.baseline.observation import Observation, StepConditions
from semlive.diagnose.maps.effect_selection import SIGNIFICANCE_LEVEL, SIGNIFICANT_LOG_FACTOR
from semlive.diagnose.scalars.regression import RegressionTerm, f_test, orthonormal_basis, term
from semlive.model.effects.stage import BACKLASH, MOVES, QUADRATIC, StageEffectClass

Array = NDArray[np.float64]
LEAST_PX = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class StageMoves:
    """What the stage was told, and what the picture did.

    Attributes:
        commanded_px: (n, 2) places.
        fitted_px: (n, 2).
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
    """Of pairs that were not loaded: a load carries the specimen along."""
    solution = observation.solution
    motions = solution.state.motions
    unloaded = [one for one in steps if one.phase is not Phase.TENSION]
    fitted = [motions.shift_and_gradient(one.pair, solution.part("motion"))[0] for one in unloaded]
    return StageMoves(np.array([one.shift_px for one in unloaded]).reshape(-1, 2), np.array(fitted).reshape(-1, 2))


def add_stage_evidence(found: Diagnosis, moves: StageMoves) -> Diagnosis:
    """The verdict with what the stage did beside it.

    Scale and angle of the stage are the estimate's own notes, as they cannot be told from the picture's. Drift between pairs counts as a
    parabola in time. Backlash and a scale that changes along the way are each asked beside the other.
    """
    already = {one.name for one in (*found.model_effects, *found.effects)}
    tests = {one.name: _test(moves, one) for one in MOVES}
    heard = {name: one for name, one in tests.items() if one is not None}
    if not heard:
        return found
    p_value = min(1.0, len(heard) * min(one.p_value for one in heard.values()))
    rms_px = max(float(np.sqrt(np.mean(one.value_px**2))) for one in heard.values())
    loud = [
        one for one in heard.values()
        if one.family.name not in already and one.log_factor >= SIGNIFICANT_LOG_FACTOR and len(heard) * one.p_value <= SIGNIFICANCE_LEVEL
    ]  # fmt: skip
    effects = tuple(one.effect(len(heard)) for one in loud)
    outcome = Outcome.IDENTIFIED if effects and found.outcome is Outcome.NONE else found.outcome
    evidence = tuple((name, one.log_factor) for name, one in heard.items())
    where = (*found.where, DomainTest("moves", p_value, rms_px))
    return replace(found, outcome=outcome, effects=(*found.effects, *effects), where=where, evidence=(*found.evidence, *evidence))


@dataclass(frozen=True, slots=True, eq=False)
class _Test:
    """A term of both axes: its values, their uncertainties, and how much it explains."""

    family: StageEffectClass
    value: Array
    sigma: Array
    value_px: Array
    p_value: float
    log_factor: float

    def effect(self, tests: int) -> IdentifiedEffect:
        what, unit = ("backlash", "px") if self.family is BACKLASH else ("quadratic", "1/px")
        ending = "_px" if self.family is BACKLASH else "_per_px"
        parameters = tuple(
            ParameterEstimate(f"{what}_{axis}{ending}", float(value), float(sigma), unit)
            for axis, value, sigma in zip("xy", self.value, self.sigma, strict=True)
        )
        size_px = float(np.abs(self.value_px).max())
        law = ModelEffect(self.family.name, (), size_px)
        return IdentifiedEffect(self.family.name, parameters, size_px, self.log_factor, min(1.0, tests * self.p_value), False, law)


def _test(moves: StageMoves, family: StageEffectClass) -> _Test | None:
    """F-test of a term along each axis that it can be seen on, beside the other term; None where neither axis shows it."""
    terms = {BACKLASH.name: moves.direction, QUADRATIC.name: moves.commanded_px**2}
    own, others = terms[family.name], [one for name, one in terms.items() if name != family.name]
    value, sigma, value_px = (np.zeros(2) for _ in range(3))
    seen: list[RegressionTerm] = []
    for axis in (0, 1):
        found = term(own[:, axis], moves.fitted_px[:, axis], _base(moves, [one[:, axis] for one in others]))
        if found is not None:
            value[axis], sigma[axis] = found.value, found.sigma
            value_px[axis] = found.value * float(np.abs(own[:, axis]).max())
            seen.append(found)
    told = f_test(seen)
    return None if told is None else _Test(family, value, sigma, value_px, *told)


def _base(moves: StageMoves, more: Sequence[Array]) -> Array:
    """(n, k) orthonormal: an offset, both commands, drift as a parabola in time, and other terms, as far as they say anything."""
    late = np.linspace(-1.0, 1.0, len(moves.commanded_px))
    return orthonormal_basis(np.stack([np.ones_like(late), *moves.commanded_px.T, late, late**2, *more], axis=-1), LEAST_PX * 1e-3)
