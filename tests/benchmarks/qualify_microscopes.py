"""Microscopes drawn at random, rendered by the simulators and qualified from their export folder by the code of the command.

Each is of one of six characters, in turn; all have random scan times, noise, drift, distortion and stage. The effect of the character has
a random size, drawn without regard to what can be detected, so that it limits the strain or does not. The pairs are those of the run that
the command plans for the microscope, with the pairs in place until its true drift has settled as the plan defines it. Commanded shifts are
given in ``frames.csv``, as a user would.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from qualify_still import Truth
from qualify_truth import Strains, true_strains, truth_of

from semlive.data.experiment import WarmUp
from semlive.qualify.values import Qualification
from semlive.service.config.configuration import load_config
from semlive.service.qualification.plan import plan_of
from semlive.service.qualification.run import QualifyRequest, qualify_source
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.simulate import simulate
from semlive_simulators.specimen.protocol_player import START_NS, ProtocolPlayer

CHARACTERS = ("good", "warm tungsten", "hum, vibration or jitter", "settling", "wrong row time", "poor stage")
WIDTH_PX, HEIGHT_PX, PIXEL_UM = 512, 442, 1.25
FRAME_S = (2.0, 90.0)
"""Shortest and longest frame, drawn uniformly in the logarithm, as all sizes below."""
LARGEST_SHIFT_PX = 14.0
MAX_IN_PLACE = 40
"""More pairs than the longest warm-up has: half an hour at 30 s of hold and 2 s per frame."""
Fields = dict[str, object]


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A microscope and its qualification.

    Attributes:
        number: number of the microscope.
        character: one of `CHARACTERS`.
        found: the qualification.
        truths: true values of its figures by name.
        strains: true strain of each source.
        beam_s: beam time of its pairs.
    """

    number: int
    character: str
    found: Qualification
    truths: Mapping[str, Truth]
    strains: Strains
    beam_s: float


def character_of(number: int) -> str:
    """Character of a microscope."""
    return CHARACTERS[number % len(CHARACTERS)]


class _Draw:
    """Random values of one microscope."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng((seed, 37))

    def size(self, low: float, high: float) -> float:
        """A size, uniform in its logarithm."""
        return float(np.exp(self.rng.uniform(math.log(low), math.log(high))))

    def normal(self, sd: float) -> float:
        """A value of either sign."""
        return float(sd * self.rng.standard_normal())

    def wave(self, size_px: float) -> Fields:
        """A component of the distortion of about a given size."""
        polynomial = {name: self.normal(size_px) for name in ("xx_px", "xy_px", "yy_px")}
        waves = {"wave_px": self.normal(0.4 * size_px), "wave_x": self.rng.uniform(0.3, 1.2), "wave_y": self.rng.uniform(0.3, 1.2)}
        return {"constant_px": 0.0, **polynomial, **waves, "wave_phase_rad": self.rng.uniform(-math.pi, math.pi)}

    def drift(self, warmup_px: float, warmup_s: float, rate_px_s: float) -> Fields:
        """One axis of a drift."""
        return {"warmup_px": self.normal(warmup_px), "warmup_s": warmup_s, "linear_px_s": self.normal(rate_px_s), "quadratic_px_s2": 0.0}


def draw_scenario(number: int, seed: int, folder: Path) -> Scenario:
    """Draw a microscope; its scenario is written to a folder."""
    path = folder / "microscope.yaml"
    path.write_text(yaml.safe_dump(_plain(_fields(character_of(number), seed))), encoding="utf-8")
    return load_scenario(str(path))


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return float(value) if isinstance(value, np.floating) else value


def _fields(character: str, seed: int) -> Fields:
    draw, kind = _Draw(seed), CHARACTERS.index(character)
    frame_s = draw.size(*FRAME_S)
    row_s = frame_s / HEIGHT_PX
    dwell_s = row_s / WIDTH_PX / draw.rng.uniform(1.02, 1.3)
    warm = kind == 1 or (kind == 4 and draw.rng.uniform() < 0.7)
    warmup_s = draw.size(200.0, 1500.0)
    warmup_px = draw.size(2.0, 20.0) if warm else draw.size(0.05, 1.5)
    rate_px_s = draw.size(1e-4, 1e-2) if warm else draw.size(1e-5, 1e-3)
    bent_px = draw.size(0.03, 1.0)
    poor = kind == 5
    stage = {
        "scale_x": 1.0 + draw.normal(0.01), "scale_y": 1.0 + draw.normal(0.01), "nonorthogonality_rad": draw.normal(0.01),
        "backlash_um": draw.size(1.0, 6.0) if poor else draw.size(0.05, 1.0),
        "position_noise_um": draw.size(2.0, 40.0) if poor else draw.size(0.03, 1.0),
        "yaw_rad": draw.size(3e-4, 5e-3) if poor else draw.size(1e-6, 3e-4),
    }  # fmt: skip
    drift = {axis: draw.drift(warmup_px, warmup_s, rate_px_s) for axis in "xy"}
    bent = {axis: draw.wave(bent_px) for axis in "xy"}
    detector = {"read_noise": draw.size(2.0, 8.0), "shot_noise": draw.size(0.05, 1.0)}
    return {
        "extends": "qualify_good",
        "name": "microscope",
        "seed": seed,
        "scan": {"dwell_time_s": dwell_s, "frame_time_s": frame_s, "gap_s": draw.size(0.1, 2.0), "rotation_rad": draw.normal(0.01)},
        "speckle": {"seed": seed},
        "detector": detector,
        "drift": drift,
        "distortion": bent,
        "stage": stage,
        "effects": _effects(kind, draw, seed, dwell_s),
        "experiment": {"protocol": {"stage_tolerance_um": 1000.0}},
    }


def _effects(kind: int, draw: _Draw, seed: int, dwell_s: float) -> Fields:
    if kind == 2:
        choice = draw.rng.integers(3)
        x_px, y_px = draw.size(0.02, 1.0), draw.size(0.01, 0.5)
        if choice == 0:
            frequency_hz = float(draw.rng.choice((50.0, 60.0))) * (1.0 + draw.normal(5e-4))
            wave = {"amplitude_x_px": x_px, "amplitude_y_px": y_px, "frequency_hz": frequency_hz}
            return {"mains_hum": {**wave, "phase_rad": draw.rng.uniform(0.0, 6.28), "harmonics": []}}
        if choice == 1:
            return {"vibration": {"amplitude_x_px": x_px, "amplitude_y_px": y_px, "frequency_hz": draw.size(3.0, 150.0), "seed": seed}}
        return {"row_jitter": {"sd_px": draw.size(0.03, 0.6), "seed": seed}}
    if kind == 3:
        length_px, size_px = draw.size(15.0, 60.0), draw.size(0.1, 6.0)
        if draw.rng.integers(2):
            return {"flyback_settling": {"amplitude_px": size_px, "settling_s": length_px * dwell_s}}
        sizes = {"amplitude_um": size_px * PIXEL_UM, "length_um": length_px * PIXEL_UM}
        return {"row_start_settling_in_position": sizes}
    if kind == 4:
        return {"wrong_row_time": {"row_time_error": draw.size(0.01, 0.4)}}
    return {}


def qualified(number: int, seed: int) -> Case:
    """Draw, render and qualify one microscope."""
    with tempfile.TemporaryDirectory(prefix="semlive-") as name:
        folder = Path(name)
        scenario = planned(draw_scenario(number, seed, folder), folder)
        shots = [shot for shot, _ in simulate(scenario, folder / "run", None)]
        found = qualify_source(QualifyRequest(folder / "run" / "export"))
    truths = truth_of(scenario, shots, found)
    return Case(number, character_of(number), found, truths, true_strains(scenario, truths, found), beam_time_s(scenario))


def planned(scenario: Scenario, folder: Path) -> Scenario:
    """The scenario with the pairs of the run that the command plans.

    Args:
        scenario: of the microscope.
        folder: for the files of the plan.
    """
    protocol, lab = scenario.experiment["protocol"], folder / "lab.yaml"
    holds = {key: protocol[key] for key in ("hold_s", "settle_s") if key in protocol}
    sem = {"folder": str(folder), "pixel_size_um": PIXEL_UM, "profile": {"frame_time_s": scenario.frame_duration_s}}
    content = {"sem": sem, "stage": {"driver": "operator"}, "protocol": {"calibration_shifts_px": [[LARGEST_SHIFT_PX, 0.0]], **holds}}
    lab.write_text(yaml.safe_dump(_plain(content)), encoding="utf-8")
    run = folder / "qualifying.yaml"
    run.write_text(plan_of(lab).text, encoding="utf-8")
    config = load_config(run)
    first, *others = config.protocol.calibration_shifts_px
    rule = config.plan().warm_up
    extra = 0 if rule is None else _warm_up_pairs(scenario, rule, others[0])
    return _with_shifts(scenario, [first, *([others[0]] * extra), *others])


def _with_shifts(scenario: Scenario, shifts_px: Sequence[tuple[float, float]]) -> Scenario:
    protocol = {**scenario.experiment["protocol"], "calibration_shifts_px": [list(shift) for shift in shifts_px]}
    return replace(scenario, experiment={**scenario.experiment, "protocol": protocol})


def _warm_up_pairs(scenario: Scenario, rule: WarmUp, place_px: tuple[float, float]) -> int:
    """Number of additional pairs until the true drift rate between the frames of a pair has settled, or the waiting time is over."""
    assert rule.max_change_px_s is not None
    played = ProtocolPlayer(_with_shifts(scenario, [place_px] * 3)).play()
    few_s = np.array([shot.start_s for shot in played]).reshape(-1, 2)
    # The third pair and those after it are at equal distances; the first begins with the move to the place.
    starts_s = few_s[1] + (few_s[2] - few_s[1]) * np.arange(-1, MAX_IN_PLACE - 1)[:, None]
    moved = np.diff(scenario.drift.at(starts_s.ravel()).reshape(-1, 2, 2), axis=1)[:, 0]
    rates = np.linalg.norm(moved, axis=1) / np.diff(starts_s, axis=1)[:, 0]
    for pair in range(1, MAX_IN_PLACE):
        waited_s = starts_s[pair, 1] - starts_s[0, 1]
        if abs(rates[pair] - rates[pair - 1]) <= rule.max_change_px_s or waited_s > rule.max_wait_s:
            return pair
    return MAX_IN_PLACE


def beam_time_s(scenario: Scenario) -> float:
    """Time of the pairs, from the begin of the run to the end of the last frame."""
    return 1e-9 * max(shot.end_ns - START_NS for shot in ProtocolPlayer(scenario).play())
