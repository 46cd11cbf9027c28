"""Readings of the sensors of the bench: load cell, extension, encoders and strain gage, with noise and faults."""

from __future__ import annotations

import math
import threading
from collections.abc import Collection
from dataclasses import dataclass, replace

from semlive_simulators.kernels.pattern import gaussian
from semlive_simulators.load_frame import dynamics
from semlive_simulators.load_frame.fault_schedule import MachineFault
from semlive_simulators.load_frame.line_faults import LineFault
from semlive_simulators.scenario import Scenario
from semlive_simulators.specimen.history import History
from semlive_simulators.specimen.specimen import at_rest
from semlive_simulators.specimen.stage import StageState
from semlive_simulators.specimen.strain_field import elongation

READINGS_PER_S = 100
_FORCE_STREAM, _EXTENSION_STREAM, _ENCODER_X_STREAM, _ENCODER_Y_STREAM = 1, 2, 3, 4


@dataclass(frozen=True, slots=True)
class ActuatorReading:
    """Position of the stage, or of the beam shift."""

    x_um: float
    y_um: float
    moving: bool
    fault: bool = False


@dataclass(frozen=True, slots=True)
class Reading:
    """Readings of all devices at an instant, with noise; `number` counts readings, `load_frame_number` those of the load frame."""

    number: int
    load_frame_number: int
    force_n: float
    extension_mm: float
    target_n: float
    load_frame_moving: bool
    load_frame_fault: bool
    load_frame_drive: dynamics.Drive
    strain_gage: float
    stage: ActuatorReading
    beam: ActuatorReading


@dataclass(frozen=True, slots=True)
class BenchState:
    """True state of load frame, stage and beam shift, and the completed steps and moves."""

    load: dynamics.LoadFrameState
    stage: StageState
    beam: StageState
    history: History


class Sensors:
    """The sensors of a bench; thread-safe. A frozen reading is kept while its fault lasts.

    Args:
        scenario: noise, errors and effects of the sensors.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._effects = scenario.effects.readings()
        self._lock = threading.Lock()
        self._frozen: Reading | None = None

    def load_n(self, force_n: float, time_s: float, history: History) -> float:
        """The reading of the load cell without noise, N, at a true force, seconds since the run began."""
        return self._effects.load_n(force_n, time_s, at_rest(load_n=force_n, history=history))

    def read(self, state: BenchState, time_s: float, number: int, faults: Collection[MachineFault | LineFault]) -> Reading:
        """Readings of all devices.

        Args:
            state: the true state.
            time_s: instant, seconds since the run began.
            number: number of the reading, which selects its noise.
            faults: faults that are active at the instant.
        """
        seed, frame, stage = self._scenario.seed, self._scenario.load_frame, self._scenario.stage
        load, history = state.load, state.history
        extension_mm = self._effects.extension_mm(load.extension_mm, load.force_n)
        noisy_n = self.load_n(load.force_n, time_s, history) + frame.cell_noise_n * gaussian(seed, _FORCE_STREAM, number)
        further_strain = self._further_strain(load, time_s, history)
        reading = Reading(
            number=number,
            load_frame_number=number,
            force_n=frame.resolved_n(noisy_n),
            extension_mm=extension_mm + frame.extension_noise_mm * gaussian(seed, _EXTENSION_STREAM, number),
            target_n=self.load_n(load.target_n, time_s, history),
            load_frame_moving=load.moving,
            load_frame_fault=load.faulty,
            load_frame_drive=load.drive,
            strain_gage=self._scenario.strain_gage.reading(self._scenario.specimen, load.force_n, seed, number, further_strain),
            stage=ActuatorReading(
                state.stage.motor_x_um + stage.encoder_noise_um * gaussian(seed, _ENCODER_X_STREAM, number),
                state.stage.motor_y_um + stage.encoder_noise_um * gaussian(seed, _ENCODER_Y_STREAM, number),
                state.stage.moving,
                state.stage.stalled,
            ),
            beam=ActuatorReading(state.beam.motor_x_um, state.beam.motor_y_um, state.beam.moving),
        )
        return self._with_faults(reading, faults)

    def _further_strain(self, load: dynamics.LoadFrameState, time_s: float, history: History) -> float:
        """Strain of the gage in addition to the elastic strain: plastic strain, creep, and the effect of holes and grains."""
        scenario, motion = self._scenario, at_rest(load_n=load.force_n, history=history)
        creep = self._effects.specimen_strain(time_s, motion, scenario.scan)
        grid_px = scenario.strain_gage.length_mm * 1e3 / scenario.scan.pixel_size_um
        local = elongation(scenario.effects, scenario.scan, motion, time_s, grid_px)
        return load.plastic_mm / scenario.specimen.length_mm + creep + local

    def _with_faults(self, reading: Reading, faults: Collection[MachineFault | LineFault]) -> Reading:
        if MachineFault.GAGE_OFF in faults:
            reading = replace(reading, strain_gage=math.nan)
        with self._lock:
            if MachineFault.FROZEN_READINGS not in faults:
                self._frozen = None
                return reading
            frozen = self._frozen = self._frozen or reading
        values = {"force_n": frozen.force_n, "extension_mm": frozen.extension_mm, "strain_gage": frozen.strain_gage}
        return replace(reading, load_frame_number=frozen.load_frame_number, **values)
