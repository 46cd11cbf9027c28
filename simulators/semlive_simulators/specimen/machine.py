"""Load frame, stage, beam shift and specimen, advanced in experiment time, with the recent motion of the specimen."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from semlive_simulators.load_frame import dynamics, fault_schedule
from semlive_simulators.load_frame.fault_schedule import MachineFault
from semlive_simulators.scenario import Scenario
from semlive_simulators.specimen import stage as stages
from semlive_simulators.specimen.history import History, LoadStep, Move
from semlive_simulators.specimen.sensors import READINGS_PER_S, BenchState, Reading, Sensors
from semlive_simulators.specimen.specimen import Motion

STEP_NS = 50_000_000
"""Time step of the simulation, counted from the start of the run: half a row time, or 1 um of stage motion."""
_STORED_S = 600.0
"""Time for which states are stored in addition to one frame, whose truth is needed after its scan."""
_CONTROL_PASSES = 6
"""Iterations of load control: each one reduces the error by the gain error of the load cell, with 2 % to 1e-10 of the load."""


@dataclass(frozen=True, slots=True)
class StateSample:
    """State at the end of a time step."""

    time_s: float
    force_n: float
    x_um: float
    y_um: float
    yaw_rad: float
    moving: bool


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """True state between two instants.

    Attributes:
        motion: motion of the specimen.
        force_mean_n: mean true force, N.
        moving: whether load frame, stage or beam shift moved.
    """

    motion: Motion
    force_mean_n: float
    moving: bool


class LoadTrain:
    """The moving parts of the bench; thread-safe.

    Attributes:
        faults: planned and ordered faults.
    """

    def __init__(self, scenario: Scenario, start_ns: int) -> None:
        self._scenario = scenario
        self._start_ns = start_ns
        self._lock = threading.Lock()
        self._steps = 0
        self._load = dynamics.at_rest(scenario.load_frame, scenario.specimen.stiffness_n_mm)
        self._stage = stages.StageState()
        self._beam = stages.StageState()
        self._samples: list[StateSample] = []
        self.faults = fault_schedule.FaultSchedule(scenario.faults)
        self._sensors = Sensors(scenario)
        self._elongation_mm = partial(_elongation_mm, scenario)
        self._history = History()
        self._max_samples = math.ceil((scenario.frame_duration_s + _STORED_S) / (STEP_NS * 1e-9))
        self._reached_n = 0.0
        self._reached_px = (0.0, 0.0)
        self._beam_reached_px = (0.0, 0.0)
        self._store_sample()

    def _store_sample(self) -> None:
        stage_um = stages.true_position_um(self._stage, self._scenario.stage)
        beam_um = stages.true_position_um(self._beam, self._scenario.beam_shift)
        x_um, y_um = stage_um[0] + beam_um[0], stage_um[1] + beam_um[1]
        moving = self._stage.moving or self._beam.moving or self._load.moving
        time_s = self._steps * STEP_NS * 1e-9
        self._samples.append(StateSample(time_s, self._load.force_n, x_um, y_um, self._stage.yaw_rad, moving))
        if len(self._samples) > 2 * self._max_samples:
            del self._samples[: self._max_samples]

    def advance_to(self, time_ns: int) -> None:
        """Advance to the first time step at or after an instant, UTC ns; never goes back."""
        last_step = -((self._start_ns - time_ns) // STEP_NS)
        with self._lock:
            while self._steps < last_step:
                load, stage, beam = self._load, self._stage, self._beam
                self._load = dynamics.step(self._load, self._scenario.load_frame, STEP_NS * 1e-9, self._elongation_mm)
                self._stage = stages.step(self._stage, self._scenario.stage, STEP_NS * 1e-9)
                self._beam = stages.step(self._beam, self._scenario.beam_shift, STEP_NS * 1e-9)
                self._steps += 1
                now_s = self._steps * STEP_NS * 1e-9
                # Exactly `now_s` of the previous step: with a rounding difference a fault at that instant would start twice.
                before_s, faults = (self._steps - 1) * STEP_NS * 1e-9, self.faults.start_ordered(now_s)
                self._load = fault_schedule.apply_faults(self._load, faults, before_s, now_s)
                if any(fault.what is MachineFault.STAGE_STALL and fault.occurs_between(before_s, now_s) for fault in faults):
                    self._stage = stages.stall(self._stage)
                self._store_sample()
                self._record_completed(load, stage, beam)

    def _record_completed(self, load: dynamics.LoadFrameState, stage: stages.StageState, beam: stages.StageState) -> None:
        """Add steps and moves that ended with the last time step to the history; states are those before it. Requires the lock."""
        time_s = self._steps * STEP_NS * 1e-9
        if load.moving and not self._load.moving:
            step = LoadStep(time_s, self._load.force_n - self._reached_n)
            self._history = replace(self._history, load_steps=(*self._history.load_steps, step))
            self._reached_n = self._load.force_n
        if stage.moving and not self._stage.moving:
            move = Move(time_s, self._reached_px, _commanded_px(self._stage, self._scenario))
            self._history = replace(self._history, moves=(*self._history.moves, move))
            self._reached_px = move.to_px
        if beam.moving and not self._beam.moving:
            shift = Move(time_s, self._beam_reached_px, _commanded_px(self._beam, self._scenario))
            self._history = replace(self._history, beam_shifts=(*self._history.beam_shifts, shift))
            self._beam_reached_px = shift.to_px

    def read(self, time_ns: int) -> Reading:
        """Readings of all devices at an instant, UTC ns."""
        self.advance_to(time_ns)
        number = max(0, (time_ns - self._start_ns) * READINGS_PER_S // 1_000_000_000)
        with self._lock:
            state = BenchState(self._load, self._stage, self._beam, self._history)
        time_s = (time_ns - self._start_ns) * 1e-9
        active = {fault.what for fault in self.faults.active_and_planned() if fault.lasts(time_s)}
        return self._sensors.read(state, time_s, number, active)

    def window(self, first_s: float, last_s: float) -> Window:
        """The true state between two recent instants, seconds since the run began."""
        with self._lock:
            newest = self._samples[-1].time_s
            step_s = STEP_NS * 1e-9
            count = math.ceil((newest - first_s) / step_s) + 2
            recent = self._samples[-max(count, 2) :]
            history = self._history
        samples = [entry for entry in recent if first_s - step_s < entry.time_s < last_s + step_s] or recent[-1:]
        force = np.array([entry.force_n for entry in samples])
        yaw = np.array([entry.yaw_rad for entry in samples])
        position = np.array([(entry.x_um, entry.y_um) for entry in samples])
        specimen = self._scenario.specimen
        shift = position / self._scenario.scan.pixel_size_um + specimen.shift_px(force)
        motion = Motion(np.array([entry.time_s for entry in samples]), shift, specimen.gradient(force, yaw), force, history)
        return Window(motion, float(force.mean()), any(entry.moving for entry in samples))

    def ramp_to(self, force_n: float, rate_n_s: float) -> None:
        """Start a ramp in load control to a reading of the load cell of `force_n`."""
        with self._lock:
            time_s, true_n = self._steps * STEP_NS * 1e-9, force_n
            for _ in range(_CONTROL_PASSES):
                step = LoadStep(time_s, true_n - self._reached_n)
                history = replace(self._history, load_steps=(*self._history.load_steps, step))
                true_n += force_n - self._sensors.load_n(true_n, time_s, history)
            self._load = dynamics.ramp_to(self._load, true_n, rate_n_s)

    def jog(self, speed_mm_s: float) -> None:
        """Start a motion of the crosshead in displacement control, tension positive."""
        with self._lock:
            self._load = dynamics.jog(self._load, speed_mm_s)

    def travel_to(self, extension_mm: float, speed_mm_s: float) -> None:
        """Start a motion of the crosshead to an extension in displacement control, then hold it."""
        with self._lock:
            self._load = dynamics.travel_to(self._load, extension_mm, speed_mm_s)

    def stop_load(self) -> None:
        """Stop the load frame and hold position."""
        with self._lock:
            load = self._load
            self._load = dynamics.stop(load)
            self._record_completed(load, self._stage, self._beam)

    def move_stage(self, x_um: float, y_um: float, actuator: stages.Actuator = stages.Actuator.STAGE) -> None:
        """Start a move of the stage, or a beam shift."""
        with self._lock:
            if actuator is stages.Actuator.BEAM_SHIFT:
                # Another seed, so that the errors of the beam shift are independent of those of the stage.
                self._beam = stages.start_move(self._beam, self._scenario.beam_shift, x_um, y_um, self._scenario.seed + 1)
                return
            self._stage = stages.start_move(self._stage, self._scenario.stage, x_um, y_um, self._scenario.seed)

    def stop_stage(self, actuator: stages.Actuator = stages.Actuator.STAGE) -> None:
        """Stop the stage, or the beam shift."""
        with self._lock:
            stage, beam = self._stage, self._beam
            if actuator is stages.Actuator.BEAM_SHIFT:
                self._beam = stages.stop(beam)
            else:
                self._stage = stages.stop(stage)
            self._record_completed(self._load, stage, beam)

    def trip_watchdog(self) -> None:
        """Stop load frame and stage after the watchdog expired; the load frame reports a fault."""
        with self._lock:
            load, stage = self._load, self._stage
            self._load, self._stage = dynamics.trip_watchdog(load), stages.stop(stage)
            self._record_completed(load, stage, self._beam)

    @property
    def jogging_mm_s(self) -> float:
        """Speed of the crosshead in displacement control, mm/s; 0 in other states."""
        with self._lock:
            return self._load.jog_mm_s if self._load.drive is dynamics.Drive.JOGGING else 0.0

    @property
    def locked(self) -> bool:
        """Whether the load frame refuses motions until a stop: after its force limit, or an emergency stop."""
        with self._lock:
            return self._load.drive in (dynamics.Drive.OVERLOAD, dynamics.Drive.EMERGENCY)


def _commanded_px(state: stages.StageState, scenario: Scenario) -> tuple[float, float]:
    pixel_um = scenario.scan.pixel_size_um
    return state.motor_x_um / pixel_um, state.motor_y_um / pixel_um


def _elongation_mm(scenario: Scenario, peak_n: float) -> float:
    """Plastic elongation of the specimen after a highest load, N."""
    return scenario.effects.plastic_strain(peak_n) * scenario.specimen.length_mm
