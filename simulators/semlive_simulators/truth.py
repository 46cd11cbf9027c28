"""The true values of a run, collected while the bench runs and written for the score of the measurement."""

from __future__ import annotations

import json

import numpy as np

from semlive_simulators.effects.interfaces import Instants
from semlive_simulators.effects.library import as_mapping
from semlive_simulators.scenario import Scenario
from semlive_simulators.specimen.history import EMPTY_HISTORY, History
from semlive_simulators.specimen.specimen import Motion, at_rest
from semlive_simulators.specimen.strain_field import strain_field, without_optical_effects

DRIFT_EVERY_S = 5.0
GRID_PX = 25.0
FIELD_PX = 50.0


def frame_truth(
    scenario: Scenario, file: str, start_time_ns: int, start_s: float, motion: Motion, load_mean_n: float, moving: bool
) -> dict[str, object]:
    """The truth of one frame.

    Args:
        scenario: the simulated experiment.
        file: name of the exported file.
        start_time_ns: start of the scan, UTC ns.
        start_s: start of the scan, seconds since the run began.
        motion: motion of the specimen during the scan.
        load_mean_n: mean true load, N.
        moving: whether load frame, stage or beam shift moved during the scan.

    Returns:
        The JSON object of the frame. ``strain`` is the mean over the frame; if the strain is not uniform, ``field`` holds displacement
        and strain at points about 50 px apart, in material coordinates.
    """
    middle_s = np.array([start_s + 0.5 * scenario.frame_duration_s])
    middle = scenario.effects.moved(Instants(middle_s, start_s, 0, scenario.scan, motion))
    gradient = middle.gradient[0]
    truth: dict[str, object] = {
        "file": file,
        "start_time_ns": start_time_ns,
        "row_time_s": scenario.scan.row_time_s,
        "load_mean_n": load_mean_n,
        "stage_px": middle.shift_px[0].tolist(),
        "gradient": gradient.tolist(),
        "moving": moving,
    }
    if not without_optical_effects(scenario.effects).deforming:
        exy = float(0.5 * (gradient[0, 1] + gradient[1, 0]))
        return truth | {"strain": {"exx": float(gradient[0, 0]), "eyy": float(gradient[1, 1]), "exy": exy}}
    field = strain_field(scenario.effects, scenario.scan, motion, float(middle_s[0]), start_s, FIELD_PX)
    components = {"exx": field.exx, "eyy": field.eyy, "exy": field.exy}
    points = {"x_px": field.x_px, "y_px": field.y_px, "u_px": field.u_px, "v_px": field.v_px}
    return truth | {
        "strain": {name: float(values.mean()) for name, values in components.items()},
        "field": {name: values.tolist() for name, values in (points | components).items()},
    }


def distortion_truth(scenario: Scenario) -> dict[str, object]:
    """True distortion on a grid of about 25 px that includes the edges of the frame."""
    scan = scenario.scan
    x_px = np.linspace(0, scan.width_px - 1, max(2, round(scan.width_px / GRID_PX) + 1))
    y_px = np.linspace(0, scan.height_px - 1, max(2, round(scan.height_px / GRID_PX) + 1))
    offset_px = scenario.distortion.at(*np.meshgrid(x_px, y_px), scan.width_px, scan.height_px)
    return {"x_px": x_px.tolist(), "y_px": y_px.tolist(), "ex_px": offset_px[..., 0].tolist(), "ey_px": offset_px[..., 1].tolist()}


def drift_truth(scenario: Scenario, start_ns: int, now_ns: int, history: History = EMPTY_HISTORY) -> dict[str, object]:
    """True drift every 5 s from the start of the run up to now, without jumps."""
    count = max(0, int((now_ns - start_ns) * 1e-9 / DRIFT_EVERY_S)) + 2
    time_s = np.asarray(np.arange(count) * DRIFT_EVERY_S, dtype=np.float64)
    drift = scenario.drift.at(time_s)
    effect_drift = scenario.effects.drift_px(Instants(time_s, 0.0, 0, scenario.scan, at_rest(history=history)))
    drift = drift if effect_drift is None else drift + effect_drift
    step_ns = round(DRIFT_EVERY_S * 1e9)
    return {
        "time_ns": [start_ns + index * step_ns for index in range(count)],
        "dx_px": drift[:, 0].tolist(),
        "dy_px": drift[:, 1].tolist(),
    }


class TruthRecorder:
    """Collects the truth of frames, and encodes it as JSON."""

    def __init__(self, scenario: Scenario, start_ns: int) -> None:
        self._scenario = scenario
        self._start_ns = start_ns
        self._frames: list[str] = []
        self._history = EMPTY_HISTORY
        self._distortion = json.dumps(distortion_truth(scenario))

    def add_frame(self, frame: dict[str, object], history: History) -> None:
        """Store the truth of a frame, and the history of the specimen up to it."""
        self._history = history
        self._frames.append(json.dumps(frame))

    def encode(self, now_ns: int, clock_stretches: int, worst_lag_s: float) -> bytes:
        """The truth up to now as JSON."""
        scenario = self._scenario
        head = {
            "version": 1,
            "scenario": scenario.name,
            "seed": scenario.seed,
            "youngs_modulus_gpa": scenario.specimen.youngs_modulus_gpa,
            "poissons_ratio": scenario.specimen.poissons_ratio,
            "pixel_size_m": scenario.scan.pixel_size_um / 1e6,
            "centre_px": scenario.scan.centre_px.tolist(),
            "start_time_ns": self._start_ns,
            "clock_stretches": clock_stretches,
            "worst_lag_s": worst_lag_s,
            "effects": as_mapping(scenario.effects),
        }
        parts = [
            json.dumps(head)[:-1],
            '"frames": [' + ",\n".join(self._frames) + "]",
            '"drift": ' + json.dumps(drift_truth(scenario, self._start_ns, now_ns, self._history)),
            '"distortion": ' + self._distortion + "}",
        ]
        return (",\n".join(parts) + "\n").encode()
