"""Load frame and stage of the bench: invariants for all commands."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from semlive_simulators.effects.library import build_effects
from semlive_simulators.load_frame import dynamics, fault_schedule
from semlive_simulators.load_frame.dynamics import Drive, LoadFrameState
from semlive_simulators.load_frame.fault_schedule import MachineFault, PlannedFault
from semlive_simulators.scenario import load_scenario
from semlive_simulators.specimen import stage
from semlive_simulators.specimen.machine import STEP_NS, LoadTrain

SCENARIO = load_scenario("paper_x200")
MACHINE = SCENARIO.load_frame
TABLE = SCENARIO.stage
DT_S = 0.05


def run(state: LoadFrameState, seconds: float) -> list[LoadFrameState]:
    states = [state]
    for _ in range(round(seconds / DT_S)):
        states.append(dynamics.step(states[-1], MACHINE, DT_S))
    return states


def loaded(target_n: float, rate_n_s: float = 50.0) -> LoadFrameState:
    state = dynamics.ramp_to(dynamics.at_rest(MACHINE, SCENARIO.specimen.stiffness_n_mm), target_n, rate_n_s)
    states = run(state, abs(target_n) / rate_n_s + 30.0)
    return next(state for state in states if state.drive is Drive.HOLDING)


@settings(max_examples=25, deadline=None)
@given(target_n=st.floats(-500, 2200), rate_n_s=st.floats(5, 100))
def test_a_ramp_arrives_and_never_outruns_its_rate(target_n: float, rate_n_s: float) -> None:
    start = dynamics.ramp_to(dynamics.at_rest(MACHINE, SCENARIO.specimen.stiffness_n_mm), target_n, rate_n_s)
    states = run(start, abs(target_n) / rate_n_s + 20.0)
    creep_n = MACHINE.relaxation_fraction * max(abs(target_n), 1.0) * DT_S / MACHINE.relaxation_time_s
    changes = [abs(after.force_n - before.force_n) for before, after in itertools.pairwise(states)]
    assert max(changes) <= rate_n_s * DT_S + creep_n + 1e-9
    assert states[-1].drive is Drive.HOLDING
    arrival = next(state for state in states if state.drive is Drive.HOLDING)
    assert abs(arrival.force_n - target_n) <= MACHINE.arrived_n


def test_relaxation_takes_three_tenths_of_a_percent_of_the_load_at_held_position() -> None:
    held = loaded(2200.0)
    later = run(held, 200.0)[-1]
    assert later.extension_mm == held.extension_mm
    full_n = MACHINE.relaxation_fraction * held.stiffness_n_mm * held.extension_mm
    assert later.relaxed_n == pytest.approx(full_n, rel=1e-3)
    # A ramp of 44 s has let most of it happen: full (tau / T) (1 - exp(-T / tau)) is left, less what the last approach takes.
    left_n = full_n * (20 / 44) * (1 - math.exp(-44 / 20))
    assert left_n * math.exp(-7 / 20) < held.force_n - later.force_n < left_n
    soon = run(held, 20.0)[-1]
    assert soon.force_n - later.force_n == pytest.approx((held.force_n - later.force_n) / math.e, rel=1e-2)


@settings(max_examples=25, deadline=None)
@given(parts=st.integers(1, 8))
def test_relaxation_does_not_depend_on_the_step(parts: int) -> None:
    held = loaded(1500.0)
    once = dynamics.step(held, MACHINE, 4.0)
    split = held
    for _ in range(parts):
        split = dynamics.step(split, MACHINE, 4.0 / parts)
    assert split.force_n == pytest.approx(once.force_n, abs=1e-9)


def test_stop_in_a_ramp_holds_the_position() -> None:
    start = dynamics.ramp_to(dynamics.at_rest(MACHINE, SCENARIO.specimen.stiffness_n_mm), 2000.0, 50.0)
    stopped = dynamics.stop(run(start, 10.0)[-1])
    assert stopped.drive is Drive.HOLDING
    assert stopped.target_n == stopped.force_n
    assert run(stopped, 50.0)[-1].extension_mm == stopped.extension_mm


def test_the_force_limit_stops_the_machine_with_a_fault_and_lets_it_unload() -> None:
    limited = dataclasses.replace(MACHINE, force_limit_n=500.0)
    state = dynamics.ramp_to(dynamics.at_rest(limited, SCENARIO.specimen.stiffness_n_mm), 1000.0, 50.0)
    for _ in range(1000):
        state = dynamics.step(state, limited, DT_S)
    assert state.drive is Drive.OVERLOAD
    assert 500.0 < state.force_n + state.relaxed_n < 510.0
    state = dynamics.ramp_to(dynamics.stop(state), 0.0, 50.0)
    for _ in range(1000):
        state = dynamics.step(state, limited, DT_S)
    assert state.drive is Drive.HOLDING
    assert abs(state.force_n) < 2.0


def test_an_expired_watchdog_is_a_fault_until_the_next_order() -> None:
    expired = dynamics.trip_watchdog(loaded(300.0))
    assert expired.faulty
    assert run(expired, 5.0)[-1].extension_mm == expired.extension_mm
    assert not dynamics.stop(expired).faulty
    assert not dynamics.ramp_to(expired, 0.0, 10.0).faulty


def test_displacement_control_runs_at_its_speed() -> None:
    state = run(dynamics.jog(dynamics.at_rest(MACHINE, SCENARIO.specimen.stiffness_n_mm), 0.01), 10.0)[-1]
    assert state.moving
    assert state.extension_mm == pytest.approx(0.1)
    assert state.force_n + state.relaxed_n == pytest.approx(0.1 * state.stiffness_n_mm)


def plastic_mm(peak_n: float) -> float:
    """Ramberg and Osgood's law for 50 mm of annealed sheet, written independently."""
    return 50.0 * 0.002 * (max(peak_n, 0.0) / 10.0 / 95.0) ** 2.25


@settings(max_examples=10, deadline=None)
@given(target_n=st.floats(300, 2200))
def test_a_yielding_specimen_is_pulled_until_the_load_is_there_and_stays_longer(target_n: float) -> None:
    stiff = dataclasses.replace(MACHINE, relaxation_fraction=0.0)
    state = dynamics.ramp_to(dynamics.at_rest(stiff, SCENARIO.specimen.stiffness_n_mm), target_n, 100.0)
    while state.moving:
        state = dynamics.step(state, stiff, DT_S, plastic_mm)
    assert abs(state.force_n - target_n) <= stiff.arrived_n
    assert state.extension_mm == pytest.approx(state.force_n / state.stiffness_n_mm + plastic_mm(state.force_n), rel=1e-9)
    peak_n = state.force_n
    state = dynamics.ramp_to(state, 0.0, 100.0)
    while state.moving:
        state = dynamics.step(state, stiff, DT_S, plastic_mm)
    assert state.extension_mm == pytest.approx(plastic_mm(peak_n) + state.force_n / state.stiffness_n_mm, rel=1e-9)


def test_in_displacement_control_a_yielding_specimen_carries_less() -> None:
    stiff = dataclasses.replace(MACHINE, relaxation_fraction=0.0)
    state = dynamics.jog(dynamics.at_rest(stiff, SCENARIO.specimen.stiffness_n_mm), 0.02)
    for _ in range(600):
        state = dynamics.step(state, stiff, DT_S, plastic_mm)
    assert state.extension_mm == pytest.approx(0.6)
    assert state.force_n < 0.9 * 0.6 * state.stiffness_n_mm
    assert state.force_n / state.stiffness_n_mm + plastic_mm(state.force_n) == pytest.approx(0.6, abs=1e-8)


def test_crosshead_and_strain_gage_include_plastic_strain() -> None:
    plastic = build_effects({"plastic_hardening": {"area_mm2": 10.0, "proof_stress_mpa": 95.0, "exponent": 2.25}})
    readings = []
    for scenario in (SCENARIO, dataclasses.replace(SCENARIO, effects=plastic)):
        machine = LoadTrain(scenario, 0)
        machine.ramp_to(2200.0, 100.0)
        readings.append(machine.read(30_000_000_000))
    elastic, longer = readings
    assert longer.force_n == pytest.approx(elastic.force_n, abs=2.0)
    assert longer.extension_mm - elastic.extension_mm == pytest.approx(plastic_mm(2200.0), rel=2e-3)
    assert longer.strain_gage - elastic.strain_gage == pytest.approx(1.005 * plastic_mm(2200.0) / 50.0, rel=2e-3)


def test_a_limit_switch_stops_the_way_out_and_lets_it_back() -> None:
    near = dataclasses.replace(MACHINE, extension_max_mm=0.05)
    state = dynamics.jog(dynamics.at_rest(near, SCENARIO.specimen.stiffness_n_mm), 0.01)
    for _ in range(400):
        state = dynamics.step(state, near, DT_S)
    assert (state.drive, state.extension_mm) == (Drive.LIMIT, 0.05)
    again = dynamics.step(dynamics.jog(state, 0.01), near, DT_S)
    assert (again.drive, again.extension_mm) == (Drive.LIMIT, 0.05)
    back = dynamics.step(dynamics.jog(state, -0.01), near, DT_S)
    assert back.drive is Drive.JOGGING
    assert back.extension_mm < 0.05


def test_grips_slip_once_and_load_control_makes_it_good() -> None:
    slipping = dataclasses.replace(MACHINE, slip_n=800.0, slip_mm=0.02)
    state = dynamics.ramp_to(dynamics.at_rest(slipping, SCENARIO.specimen.stiffness_n_mm), 1200.0, 50.0)
    forces = [state.force_n]
    for _ in range(1200):
        state = dynamics.step(state, slipping, DT_S)
        forces.append(state.force_n)
    drops = [before - after for before, after in itertools.pairwise(forces) if before - after > 10.0]
    assert len(drops) == 1
    assert drops[0] == pytest.approx(0.02 * state.stiffness_n_mm, abs=3.0)
    assert state.slipped_mm == 0.02
    assert state.force_n == pytest.approx(1200.0, abs=5.0)


def test_a_broken_specimen_carries_nothing_and_load_control_runs_away_to_the_switch() -> None:
    brittle = dataclasses.replace(MACHINE, fracture_n=700.0, extension_max_mm=0.3)
    state = dynamics.ramp_to(dynamics.at_rest(brittle, SCENARIO.specimen.stiffness_n_mm), 1500.0, 50.0)
    highest = 0.0
    for _ in range(2000):
        state = dynamics.step(state, brittle, DT_S)
        highest = max(highest, state.force_n)
    assert 690.0 < highest <= 700.0
    assert state.broken
    assert state.force_n == 0.0
    assert (state.drive, state.extension_mm) == (Drive.LIMIT, 0.3)


@pytest.mark.parametrize(("what", "drive"), [(MachineFault.EMERGENCY_STOP, Drive.EMERGENCY), (MachineFault.LIMIT_SWITCH, Drive.LIMIT)])
def test_a_planned_stop_comes_at_its_instant(what: MachineFault, drive: Drive) -> None:
    ramping = dynamics.ramp_to(loaded(300.0), 800.0, 10.0)
    faults = (PlannedFault(7.0, what),)
    assert fault_schedule.apply_faults(ramping, faults, 6.9, 6.95) == ramping
    stopped = fault_schedule.apply_faults(ramping, faults, 6.95, 7.0)
    assert (stopped.drive, stopped.faulty, stopped.moving) == (drive, True, False)
    assert fault_schedule.apply_faults(dynamics.stop(stopped), faults, 7.0, 7.05).drive is Drive.HOLDING


def test_a_pressed_emergency_stop_obeys_nobody_until_it_is_released() -> None:
    faults = (PlannedFault(7.0, MachineFault.EMERGENCY_STOP, lasts_s=3.0),)
    state = fault_schedule.apply_faults(loaded(300.0), faults, 6.95, 7.0)
    for now_s in (7.05, 8.0, 9.95):
        ordered = dynamics.ramp_to(dynamics.stop(state), 800.0, 10.0)
        state = fault_schedule.apply_faults(ordered, faults, now_s - DT_S, now_s)
        assert state.drive is Drive.EMERGENCY
    assert fault_schedule.apply_faults(dynamics.stop(state), faults, 10.0, 10.05).drive is Drive.HOLDING


def test_planned_slip_and_fracture_take_the_load_away() -> None:
    held = loaded(300.0)
    slipped = fault_schedule.apply_faults(held, (PlannedFault(1.0, MachineFault.GRIP_SLIP, slip_mm=0.01),), 0.95, 1.0)
    assert held.force_n - slipped.force_n == pytest.approx(0.01 * held.stiffness_n_mm)
    assert fault_schedule.apply_faults(held, (PlannedFault(1.0, MachineFault.FRACTURE),), 0.95, 1.0).force_n == 0.0


def moved(state: stage.StageState, x_um: float, y_um: float) -> stage.StageState:
    state = stage.start_move(state, TABLE, x_um, y_um, seed=5)
    while state.moving:
        state = stage.step(state, TABLE, DT_S)
    return state


@settings(max_examples=50, deadline=None)
@given(moves=st.lists(st.tuples(st.floats(-100, 100), st.floats(-100, 100)), min_size=1, max_size=6))
def test_the_stage_ends_near_its_goal_within_backlash_and_its_geometry(moves: list[tuple[float, float]]) -> None:
    state = stage.StageState()
    for x_um, y_um in moves:
        state = moved(state, x_um, y_um)
        assert math.hypot(state.motor_x_um - x_um, state.motor_y_um - y_um) < 6 * TABLE.position_noise_um
        assert abs(state.table_x_um - state.motor_x_um) <= 0.5 * TABLE.backlash_um + 1e-12
        true_x, true_y = stage.true_position_um(state, TABLE)
        assert abs(true_x - x_um) < 0.0275 * 100 * math.sqrt(2) + 6 * TABLE.position_noise_um + TABLE.backlash_um
        assert abs(true_y - y_um) < 0.01 * 100 + 6 * TABLE.position_noise_um + TABLE.backlash_um
        assert abs(state.yaw_rad) <= 1.5 * TABLE.yaw_rad


def test_the_table_comes_to_rest_at_another_place_from_the_other_side() -> None:
    silent = dataclasses.replace(TABLE, position_noise_um=0.0)

    def goto(state: stage.StageState, x_um: float) -> stage.StageState:
        state = stage.start_move(state, silent, x_um, 0.0, seed=1)
        while state.moving:
            state = stage.step(state, silent, DT_S)
        return state

    from_left = goto(goto(stage.StageState(), -20.0), 0.0)
    from_right = goto(goto(stage.StageState(), 20.0), 0.0)
    assert from_right.table_x_um - from_left.table_x_um == pytest.approx(silent.backlash_um)
    assert from_left.motor_x_um == from_right.motor_x_um == pytest.approx(0.0)


def test_the_stage_takes_its_time() -> None:
    state = stage.start_move(stage.StageState(), TABLE, 40.0, 0.0, seed=1)
    for _ in range(20):
        state = stage.step(state, TABLE, DT_S)
    assert state.moving
    assert math.hypot(state.motor_x_um, state.motor_y_um) == pytest.approx(TABLE.speed_um_s * 1.0)
    halted = stage.stop(state)
    assert stage.step(halted, TABLE, 10.0) == halted


def test_a_crosshead_goes_where_it_is_sent_and_stays_there() -> None:
    rest = dynamics.at_rest(MACHINE, SCENARIO.specimen.stiffness_n_mm)
    for start, goal_mm, speed_mm_s in ((rest, 0.2, 0.013), (loaded(1500.0), 0.05, 0.02), (rest, -0.01, 0.1)):
        states = run(dynamics.travel_to(start, goal_mm, speed_mm_s), abs(goal_mm - start.extension_mm) / speed_mm_s + 1.0)
        steps = [after.extension_mm - before.extension_mm for before, after in itertools.pairwise(states)]
        assert max(map(abs, steps)) <= speed_mm_s * DT_S + 1e-12
        assert (states[-1].extension_mm, states[-1].drive) == (goal_mm, Drive.HOLDING)
        assert states[-1].target_n == pytest.approx(states[-1].force_n, rel=0.01)


def test_a_held_load_creeps_where_a_held_position_relaxes() -> None:
    creeping = dataclasses.replace(MACHINE, hold="load")
    state, held = loaded(2000.0), []
    for parameters in (MACHINE, creeping):
        arrived = dynamics.ramp_to(state, 2010.0, 50.0)
        for _ in range(round(120.0 / DT_S)):
            arrived = dynamics.step(arrived, parameters, DT_S)
        held.append(arrived)
    assert [item.drive for item in held] == [Drive.HOLDING, Drive.HOLDING]
    assert held[0].force_n < 2010.0 - 1.5
    assert held[1].force_n == pytest.approx(2010.0, abs=0.02)
    # What grips and machine give way, in full: 0.3 % of the extension.
    assert held[1].extension_mm - 2010.0 / state.stiffness_n_mm == pytest.approx(
        MACHINE.relaxation_fraction * held[1].extension_mm, rel=0.01
    )
    for order in (dynamics.stop, dynamics.trip_watchdog, lambda item: dynamics.jog(item, 0.01)):
        assert not order(held[1]).keeps_load


def test_a_load_held_on_a_broken_specimen_runs_to_the_limit_switch() -> None:
    state = dynamics.ramp_to(dynamics.at_rest(MACHINE, SCENARIO.specimen.stiffness_n_mm), 1000.0, 100.0)
    holding = dataclasses.replace(MACHINE, hold="load", extension_max_mm=0.5)
    for _ in range(round(30.0 / DT_S)):
        state = dynamics.step(state, holding, DT_S)
    assert (state.drive, state.keeps_load) == (Drive.HOLDING, True)
    state = dynamics.fracture(state)
    for _ in range(round(60.0 / DT_S)):
        state = dynamics.step(state, holding, DT_S)
    assert (state.drive, state.extension_mm, state.keeps_load) == (Drive.LIMIT, 0.5, False)


def test_the_strain_gage_includes_creep_of_the_specimen() -> None:
    creep = {"strain_per_n": 2e-7, "onset_s": 10.0, "poissons_ratio": 0.33}
    gage = dataclasses.replace(SCENARIO.strain_gage, noise=0.0)
    printed = []
    for chosen in ({}, {"creep_in_hold": creep}):
        world = dataclasses.replace(SCENARIO, strain_gage=gage, effects=build_effects(chosen))
        machine = LoadTrain(world, 0)
        machine.ramp_to(1000.0, 200.0)
        printed.append([machine.read(round(time_s * 1e9)).strain_gage for time_s in (0.0, 60.0, 300.0)])
    crept = printed[1][1] - printed[0][1], printed[1][2] - printed[0][2]
    assert printed[0][0] == printed[1][0] == gage.offset
    # Arrived after about 10 s: ln(1 + 50 / 10) and ln(1 + 290 / 10) times 2e-4.
    assert crept == (pytest.approx(1.005 * 2e-4 * math.log(6.0), rel=0.1), pytest.approx(1.005 * 2e-4 * math.log(30.0), rel=0.05))


def test_the_strain_gage_is_a_mean_over_its_length() -> None:
    force_n, radius_px, half_px, nu = 1500.0, 1200.0, 0.5 * 6.35e3 / 1.25, 0.33
    hole = {"defaults": "x200", "radius_px": radius_px}
    lens = {"defaults": "x200", "grains_px": [[511.5, 1500.0]]}
    gage = dataclasses.replace(SCENARIO.strain_gage, noise=0.0)
    printed = []
    for chosen in ({}, {"hole": hole}, {"charging_local_lens": lens}):
        machine = LoadTrain(dataclasses.replace(SCENARIO, strain_gage=gage, effects=build_effects(chosen)), 0)
        machine.ramp_to(force_n, 200.0)
        printed.append(machine.read(60_000_000_000).strain_gage)
        true_n = machine.window(59.9, 60.0).motion.load_at(np.array([60.0]))[0]
    # Kirsch: the point above the hole at a distance r moves outwards by this, besides the plate without a hole.
    kappa, ratio = (3 - nu) / (1 + nu), radius_px / half_px
    outwards_px = true_n / 711_000 * radius_px * (1 + nu) / 4 * (2 * ratio * (2 + kappa) - 2 * ratio**3)
    assert printed[1] - printed[0] == pytest.approx(gage.gain * outwards_px / half_px, rel=1e-3)
    assert printed[1] > 1.3 * printed[0]
    assert printed[2] == printed[0]  # what bends the beam strains nothing


def test_what_is_planned_for_a_step_of_the_machine_happens_once() -> None:
    """Steps of 50 ms are no binary fractions: (n + 1) * 0.05 - 0.05 lies below n * 0.05 for some n, these among them."""
    for number in (12, 14, 17, 19, 24, 161, 164):
        faults = (PlannedFault(number * STEP_NS * 1e-9, MachineFault.GRIP_SLIP, slip_mm=0.01),)
        slipped = LoadTrain(dataclasses.replace(SCENARIO, faults=faults), 0)
        slipped.advance_to(12_000_000_000)
        force_n = slipped.window(11.0, 12.0).force_mean_n
        assert force_n == pytest.approx(-0.01 * stiffness_n_mm_in_series(), rel=5e-3)


def stiffness_n_mm_in_series() -> float:
    return dynamics.at_rest(MACHINE, SCENARIO.specimen.stiffness_n_mm).stiffness_n_mm
