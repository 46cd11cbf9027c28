"""The experiment of a scenario in experiment time: at each stop move, settle, hold, and scan two frames."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, TypeAdapter, ValidationError

from semlive_simulators.scenario import BadScenario, Scenario
from semlive_simulators.specimen.machine import STEP_NS, LoadTrain, Window
from semlive_simulators.specimen.stage import Actuator

START_NS = 1_767_600_000_000_000_000
"""Start of every played experiment: 2026-01-05 08:00 UTC."""
_MAX_APPROACHES = 3
_LOAD_SAMPLE_NS = 1_000_000_000
_SETTLE_LIMIT_S = 900.0


@dataclass(frozen=True, slots=True)
class Protocol:
    """The part of the experiment that is played; the daemon uses the other keys.

    Attributes:
        calibration_shifts_px: commanded (x, y) shifts of the calibration stops, px.
        translation_shifts_px: commanded (x, y) shifts of the translation stops, px.
        loads_n: loads of the tensile stops, at zero shift, N.
        hold_s: hold before a pair, s.
        settle_s: time without motion after which the machine is settled, s.
        ramp_rate_n_s: rate of load changes, N/s.
        load_tolerance_n: allowed difference of the load, N.
        load_tolerance_fraction: allowed difference of the load as a fraction of it; the larger tolerance is used.
        stage_tolerance_um: allowed difference of the stage reading, um.
        recentre_beyond_px: offset of the field in the previous pair beyond which the shift corrects it, px; None never.
    """

    __pydantic_config__ = ConfigDict(extra="ignore")

    calibration_shifts_px: tuple[tuple[float, float], ...] = ()
    translation_shifts_px: tuple[tuple[float, float], ...] = ()
    loads_n: tuple[float, ...] = ()
    hold_s: float = 30.0
    settle_s: float = 5.0
    ramp_rate_n_s: float = 20.0
    load_tolerance_n: float = 10.0
    load_tolerance_fraction: float = 0.01
    stage_tolerance_um: float = 5.0
    recentre_beyond_px: float | None = None


@dataclass(frozen=True, slots=True)
class ProtocolStep:
    """A stop at which a pair is scanned: phase, commanded shift and, in the tensile phase, load."""

    phase: str
    shift_px: tuple[float, float]
    load_n: float | None


@dataclass(frozen=True, slots=True, eq=False)
class ScannedFrame:
    """A frame that was scanned, without its pixels.

    Attributes:
        frame: number of the frame; frames 2k and 2k + 1 are pair k.
        stop: stop of the protocol, with the commanded shift.
        start_s: start of the scan, seconds since the run began.
        start_ns: start of the scan, UTC ns.
        end_ns: end of the scan, UTC ns.
        window: true state during the scan.
        load_mean_n: mean reading of the load cell, N.
        gage_strain: mean reading of the strain gage, NaN without readings.
        encoder_x_um: stage position of the encoder at the end, um.
        encoder_y_um: likewise.
        beam_x_um: beam shift that the column reports at the end, um.
        beam_y_um: likewise.
    """

    frame: int
    stop: ProtocolStep
    start_s: float
    start_ns: int
    end_ns: int
    window: Window
    load_mean_n: float
    gage_strain: float
    encoder_x_um: float
    encoder_y_um: float
    beam_x_um: float
    beam_y_um: float


class ProtocolPlayer:
    """Plays the experiment of a scenario."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._protocol = _protocol(scenario)
        self._stops = _stops(self._protocol)
        self._machine = LoadTrain(scenario, START_NS)
        self.time_ns = START_NS

    @property
    def frames(self) -> int:
        """Number of frames of the complete experiment."""
        return 2 * len(self._stops)

    def play(self) -> Iterator[ScannedFrame]:
        """All frames in order.

        Raises:
            BadScenario: if a stop is never reached.
        """
        scan, export = self._scenario.scan, self._scenario.export
        self._wait(self._scenario.first_scan_s)
        origin_px, back_px = None, np.zeros(2)
        for number, planned in enumerate(self._stops):
            stop = replace(planned, shift_px=(planned.shift_px[0] + float(back_px[0]), planned.shift_px[1] + float(back_px[1])))
            self._go_to(stop)
            self._wait(self._protocol.hold_s)
            first = self._scan(2 * number, stop)
            yield first
            self._wait(scan.gap_s)
            second = self._scan(2 * number + 1, stop)
            yield second
            origin_px = self._field_px(first) - planned.shift_px if origin_px is None else origin_px
            back_px = back_px - self._correction_px(self._field_px(second) - planned.shift_px - origin_px)
            self._wait(export.delay_s + export.duration_s)

    def _correction_px(self, offset_px: NDArray[np.float64]) -> NDArray[np.float64]:
        beyond_px = self._protocol.recentre_beyond_px
        return offset_px if beyond_px is not None and np.abs(offset_px).max() > beyond_px else np.zeros(2)

    def _field_px(self, shot: ScannedFrame) -> NDArray[np.float64]:
        """(2,) position of the specimen centre in a frame, px: its motion and the drift of the beam."""
        middle_s = shot.start_s + 0.5 * self._scenario.frame_duration_s
        motion = shot.window.motion
        moved_px = [np.interp(middle_s, motion.time_s, motion.shift_px[:, axis]) for axis in (0, 1)]
        return np.asarray(moved_px + self._scenario.drift.at(np.array([middle_s]))[0])

    def _wait(self, seconds: float) -> None:
        self.time_ns += round(seconds * 1e9)
        self._machine.advance_to(self.time_ns)

    def _go_to(self, stop: ProtocolStep) -> None:
        """Move to a stop and settle; repeat it if relaxation or backlash exceeds the tolerance."""
        pixel_um = self._scenario.scan.pixel_size_um
        x_um, y_um = stop.shift_px[0] * pixel_um, stop.shift_px[1] * pixel_um
        for approach in range(_MAX_APPROACHES):
            if approach == 0 or not self._stage_within(x_um, y_um):
                self._machine.move_stage(x_um, y_um, self._scenario.shifts_by)
                self._wait_until_stopped(stop)
            if stop.load_n is not None and (approach == 0 or not self._load_within(stop.load_n)):
                self._machine.ramp_to(stop.load_n, self._protocol.ramp_rate_n_s)
                self._wait_until_stopped(stop)
            self._wait(self._protocol.settle_s)
            if self._stage_within(x_um, y_um) and (stop.load_n is None or self._load_within(stop.load_n)):
                return
        raise BadScenario(f"scenario {self._scenario.name}: {_name_of(stop)} is not reached within tolerance; change load_frame or stage")

    def _wait_until_stopped(self, stop: ProtocolStep) -> None:
        for _ in range(round(_SETTLE_LIMIT_S * 1e9 / STEP_NS)):
            self.time_ns += STEP_NS
            reading = self._machine.read(self.time_ns)
            if reading.load_frame_fault:
                break
            if not (reading.load_frame_moving or reading.stage.moving or reading.beam.moving):
                return
        raise BadScenario(
            f"scenario {self._scenario.name}: {_name_of(stop)} ends in a fault or takes too long; change loads_n or load_frame"
        )

    def _stage_within(self, x_um: float, y_um: float) -> bool:
        reading = self._machine.read(self.time_ns)
        position_um = (reading.stage.x_um, reading.stage.y_um)
        if self._scenario.shifts_by is Actuator.BEAM_SHIFT:
            position_um = (reading.beam.x_um, reading.beam.y_um)
        return max(abs(position_um[0] - x_um), abs(position_um[1] - y_um)) <= self._protocol.stage_tolerance_um

    def _load_within(self, load_n: float) -> bool:
        tolerance_n = max(self._protocol.load_tolerance_n, self._protocol.load_tolerance_fraction * abs(load_n))
        return abs(self._machine.read(self.time_ns).force_n - load_n) <= tolerance_n

    def _scan(self, frame: int, stop: ProtocolStep) -> ScannedFrame:
        start_ns, duration_ns = self.time_ns, round(self._scenario.frame_duration_s * 1e9)
        end_ns, start_s = start_ns + duration_ns, (start_ns - START_NS) * 1e-9
        samples = math.ceil(duration_ns / _LOAD_SAMPLE_NS)
        readings = [self._machine.read(start_ns + round(duration_ns * sample / samples)) for sample in range(samples)]
        self.time_ns = end_ns
        reading = self._machine.read(end_ns)
        window = self._machine.window(start_s, (end_ns - START_NS) * 1e-9)
        mean_n = math.fsum(sample.force_n for sample in readings) / samples
        strains = [sample.strain_gage for sample in readings if math.isfinite(sample.strain_gage)]
        mean_strain = math.fsum(strains) / len(strains) if strains else math.nan
        positions_um = (reading.stage.x_um, reading.stage.y_um, reading.beam.x_um, reading.beam.y_um)
        return ScannedFrame(frame, stop, start_s, start_ns, end_ns, window, mean_n, mean_strain, *positions_um)


def _name_of(stop: ProtocolStep) -> str:
    return f"shift {stop.shift_px[0]:g}, {stop.shift_px[1]:g} px" if stop.load_n is None else f"a load of {stop.load_n:g} N"


def _protocol(scenario: Scenario) -> Protocol:
    keys: Any = scenario.experiment.get("protocol", {})
    try:
        return TypeAdapter(Protocol).validate_python(keys)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in ("experiment", "protocol", *first["loc"]))
        raise BadScenario(f"scenario {scenario.name}: {key}: {first['msg']}; correct it") from error


def _stops(protocol: Protocol) -> tuple[ProtocolStep, ...]:
    stops = [ProtocolStep("calibration", shift, None) for shift in protocol.calibration_shifts_px]
    stops += [ProtocolStep("translation", shift, None) for shift in protocol.translation_shifts_px]
    stops += [ProtocolStep("tension", (0.0, 0.0), load_n) for load_n in protocol.loads_n]
    return tuple(stops)
