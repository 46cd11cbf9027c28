"""From a hidden experiment to a log with images: rendered by the simulated microscope, correlated and recorded as the daemon does."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "scenario" / "diagnose"))

from blind.experiment import Conditions, Pose, poses
from imaged_log import PIXEL_UM, log_of
from numexp.world import start_s

from semlive.data.experiment import Step
from semlive.data.settings import DicSettings
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.interfaces import Effect
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import load_scenario


def rendered_log(folder: Path, conditions: Conditions, effects: tuple[Effect, ...]) -> Path:
    """A log of the poses, with the paper's own drift, distortion, dots and noise (0.025 px) and the effects."""
    paper = load_scenario("paper_x200")
    speckle = replace(paper.speckle, seed=paper.speckle.seed + conditions.seed)
    scenario = replace(paper, seed=conditions.seed, speckle=speckle, effects=EffectSet(effects))
    column, reported = scenario.column(), poses(conditions)
    starts_s = [start_s(2 * pose.pair + member) for pose in reported for member in (0, 1)]
    images = (render_frame(scenario, at_s, reported[frame // 2].motion, frame, column) for frame, at_s in enumerate(starts_s))
    return log_of(folder, images, scenario.scan, starts_s, DicSettings(), [_step(item) for item in reported])


def _step(pose: Pose) -> Step:
    x_px, y_px = pose.commanded_px
    return Step(pose.pair, pose.phase, (x_px * PIXEL_UM, y_px * PIXEL_UM), pose.commanded_px, pose.load_n)
