"""From a hidden experiment to a log with images: rendered by the simulated microscope, correlated and recorded as the daemon does."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "scenario" / "diagnose"))

from blind.experiment import Conditions, Pose, poses
from imaged_log import PIXEL_UM, log_of
from numexp.world import start_s

from semlive import dic
from semlive.data.experiment import Step
from semlive.data.settings import DicSettings
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.microscope.patterns import GoldFilm, Pattern, Speckle
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import Scenario, load_scenario

NOISE_PX = 0.0125, 0.0375
"""Range of varied noise: half of that of the paper to 1.5 times it."""
PAPER_NOISE_PX = 0.025
SPARSE = DicSettings(step_px=43)


def paper_images(seed: int) -> Scenario:
    """The paper's own drift, distortion, dots and noise (0.025 px)."""
    paper = load_scenario("paper_x200")
    return replace(paper, seed=seed, speckle=replace(paper.speckle, seed=paper.speckle.seed + seed))


@cache
def varied_images(seed: int) -> Scenario:
    """The paper's drift and distortion; dots or a gold film of another size, and another noise."""
    rng, paper = np.random.default_rng((seed, 80)), paper_images(seed)
    speckle: Pattern = _dots(rng, seed) if rng.random() < 0.5 else _film(rng, seed)
    varied = replace(paper, speckle=speckle)
    factor = float(np.exp(rng.uniform(*np.log(NOISE_PX)))) / noise_px(varied)
    # The displacement noise is proportional to that of the grey levels, whose variance is that of reading plus shot noise.
    detector = replace(paper.detector, read_noise=factor * paper.detector.read_noise, shot_noise=factor**2 * paper.detector.shot_noise)
    return replace(varied, detector=detector)


def _dots(rng: np.random.Generator, seed: int) -> Speckle:
    radius_px, spread, edge_px = rng.uniform(2.2, 4.5), rng.uniform(0.05, 0.3), rng.uniform(1.5, 3.0)
    pitch_px = (radius_px * (1.0 + spread) + edge_px) * rng.uniform(1.0, 1.3)
    return Speckle(seed, pitch_px, radius_px, spread, rng.uniform(0.6, 0.95), edge_px)


def _film(rng: np.random.Generator, seed: int) -> GoldFilm:
    return GoldFilm(seed, rng.uniform(6.0, 12.0), rng.uniform(0.3, 0.7), rng.uniform(0.4, 1.0))


def noise_px(scenario: Scenario) -> float:
    """Standard deviation of the displacement between two frames of the same scene that differ by their noise only, px."""
    column = scenario.column()
    first, second = (render_frame(scenario, 0.0, None, frame, column) for frame in (0, 1))
    grid = dic.grid_for(SPARSE, scenario.scan.width_px, scenario.scan.height_px)
    found = dic.correlate(dic.prepare(first, grid, SPARSE), second, SPARSE, reference_frame=0, current_frame=1)
    return float(np.sqrt(0.5 * (found.u_px[found.valid].var() + found.v_px[found.valid].var())))


def rendered_log(folder: Path, images_of: Scenario, conditions: Conditions, effects: tuple[Effect, ...]) -> Path:
    """A log of the poses, rendered with a scenario and the effects."""
    scenario = replace(images_of, effects=EffectSet(effects))
    column, reported = scenario.column(), poses(conditions)
    starts_s = [start_s(2 * pose.pair + member) for pose in reported for member in (0, 1)]
    images = (render_frame(scenario, at_s, reported[frame // 2].motion, frame, column) for frame, at_s in enumerate(starts_s))
    return log_of(folder, images, scenario.scan, starts_s, DicSettings(), [_step(item) for item in reported])


def _step(pose: Pose) -> Step:
    x_px, y_px = pose.commanded_px
    return Step(pose.pair, pose.phase, (x_px * PIXEL_UM, y_px * PIXEL_UM), pose.commanded_px, pose.load_n)
