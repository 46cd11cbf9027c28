"""The field of view is brought back before each step, and never farther than the stage may go."""

from __future__ import annotations

from dataclasses import replace

import pytest

from semlive.data.experiment import Plan, Recentre
from semlive.engine import FieldOfViewMeasured, MoveStage, State
from semlive.engine.motion import recentre

from .bench_in_memory import LIMITS, Run, plan_of

HERE = (0.0, 0.0)
UM_PER_PX = 0.5


def recentring(*shifts_px: tuple[float, float], beyond_px: float = 1.0) -> Plan:
    plan = plan_of(*(((x * UM_PER_PX, y * UM_PER_PX), None) for x, y in shifts_px))
    steps = tuple(replace(step, shift_px=shift) for step, shift in zip(plan.steps, shifts_px, strict=True))
    return replace(plan, steps=steps, recentring=Recentre(beyond_px, UM_PER_PX))


def astray_px(plan: Plan, step: int, drift_px: tuple[float, float]) -> tuple[float, float]:
    """Offset of the field from its planned position, with the drift since frame 0."""
    (x_um, y_um), (x_px, y_px) = plan.steps[step].shift_um, plan.steps[step].shift_px
    return x_um / UM_PER_PX + drift_px[0] - x_px, y_um / UM_PER_PX + drift_px[1] - y_px


def test_a_run_takes_back_what_the_drift_carried_away() -> None:
    plan = recentring((4.0, 0.0), (12.0, 0.0), (12.0, -8.0), HERE, HERE)
    run = Run(plan, has_load=False)
    run.begin()
    drift_px = [(0.0, 0.0), (6.0, -9.0), (11.0, -16.0), (15.0, -22.0), (18.0, -27.0)]
    for pair, drift in enumerate(drift_px):
        run.reach(State.IMAGING)
        run.scan()
        run.scan()
        now, first = run.state.plan.steps[pair].shift_um, plan.steps[0].shift_um
        moved = tuple((at - began) / UM_PER_PX + off for at, began, off in zip(now, first, drift, strict=True))
        run.send(FieldOfViewMeasured(run.now_ns, pair, (moved[0], moved[1])))
        # The analysis of a pair ends after the next step began: the remaining offset is the drift of two pairs.
        remaining = [off - before for off, before in zip(drift, drift_px[max(0, pair - 2)], strict=True)]
        assert astray_px(run.state.plan, pair, drift) == pytest.approx(remaining if pair > 1 else drift)
    assert run.state.state is State.COMPLETE
    moves = [(round(move.x_um - 7.0, 6), round(move.y_um + 3.0, 6)) for move in run.of(MoveStage)]
    assert moves == [(2.0, 0.0), (6.0, 0.0), (6.0, -4.0), (-3.0, 4.5), (-5.5, 8.0)]


def test_without_the_rule_or_without_a_pair_the_plan_stays() -> None:
    plan = recentring(HERE, (8.0, 0.0))
    assert recentre(plan, LIMITS, 1, None) is plan
    assert recentre(plan, LIMITS, 1, FieldOfViewMeasured(0, 1, (50.0, 0.0))) is plan  # a step's own pair cannot be known yet
    not_recentred = replace(plan, recentring=None)
    assert recentre(not_recentred, LIMITS, 1, FieldOfViewMeasured(0, 0, (50.0, 0.0))) is not_recentred


def test_a_well_centred_field_is_not_moved() -> None:
    plan = recentring(HERE, (8.0, 0.0), (16.0, 0.0), beyond_px=5.0)
    assert recentre(plan, LIMITS, 1, FieldOfViewMeasured(0, 0, (4.9, -4.9))) == plan
    once = recentre(plan, LIMITS, 1, FieldOfViewMeasured(0, 0, (5.1, -4.9)))
    assert once.steps[1].shift_um == pytest.approx((4.0 - 2.55, 2.45))
    stored = recentre(once, LIMITS, 2, FieldOfViewMeasured(0, 1, (8.0 + 1.0, 0.5)))
    assert stored.steps[2].shift_um == pytest.approx((8.0 - 2.55, 2.45)), "what was taken back before stays taken back"


@pytest.mark.parametrize(("offset_px", "target_um"), [(900.0, -100.0), (-900.0, 100.0)])
def test_the_field_is_not_chased_beyond_the_limits(offset_px: float, target_um: float) -> None:
    plan = recentring(HERE, (8.0, 0.0))
    assert recentre(plan, LIMITS, 1, FieldOfViewMeasured(0, 0, (offset_px, 0.0))).steps[1].shift_um == (target_um, 0.0)


def test_a_plan_beyond_the_limits_is_refused_as_before() -> None:
    plan = recentring(HERE, (240.0, 0.0))  # 120 um of 100
    assert recentre(plan, LIMITS, 1, FieldOfViewMeasured(0, 0, (-50.0, 0.0))).steps[1].shift_um == (120.0, 0.0)
