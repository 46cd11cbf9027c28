"""Predicted strain noise of the drawn microscopes, compared with the error of the strain in a rendered tensile run that follows on each.

The run has the calibration, correlation and gauge of the recommended protocol, with the scan of the qualification, and three loads. Its
frames are correlated and corrected by the joint estimate as those of any run, and compared with the true strain.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from qualify_counts import seed_of
from qualify_microscopes import CHARACTERS, Case, draw_scenario

from semlive import pipeline
from semlive.data.experiment import Phase, Step
from semlive.data.pair import Pair, PairDecision
from semlive.data.settings import AnalysisSettings, DicSettings, ScanProfile
from semlive.data.strain import StrainField
from semlive.qualify.protocol import GAUGE_PX
from semlive.qualify.values import Qualification
from semlive.service.qualification.frames import list_frames, load_frame
from semlive_simulators.scenario import Scenario
from semlive_simulators.simulate import simulate
from semlive_simulators.specimen.protocol_player import ScannedFrame

Array = NDArray[np.float64]
STRAINS = (0.001, 0.002, 0.003)
"""Strain along y at each load."""
RUN_SEED = 500_000
"""Added to the seed of a microscope: the noise, moves and phases of the run are others than those of the qualification."""
MAX_NOISE_ERROR = 0.1
"""Largest relative difference of the predicted strain noise from the error of the run."""


@dataclass(frozen=True, slots=True)
class Strained:
    """The strain noise of one microscope.

    Attributes:
        character: of the microscope.
        predicted: by the qualification, the largest of exx, eyy and exy.
        found: root mean square error of gauges and frames under load, of the component with the largest.
        mean: root mean square of the mean error of a frame, of the same component; part of `found`.
    """

    character: str
    predicted: float
    found: float
    mean: float

    @property
    def ratio(self) -> float:
        """Predicted noise over the error that was found."""
        return self.predicted / self.found


def strained(case: Case) -> Strained:
    """Strain a specimen in a microscope that was qualified."""
    with tempfile.TemporaryDirectory(prefix="semlive-") as name:
        folder = Path(name)
        scenario = _loaded(draw_scenario(case.number, seed_of(case.number), folder), case.found)
        shots = [shot for shot, _ in simulate(scenario, folder / "run", None)]
        errors = list(_errors(folder / "run" / "export", shots, scenario, case.found))
    squares = np.array([np.mean(error**2, axis=0) for error in errors])
    worst = int(np.argmax(squares.mean(axis=0)))
    means = np.array([error[:, worst].mean() for error in errors])
    nearest = min(case.found.resolution, key=lambda one: abs(one.gauge_px - GAUGE_PX))
    return Strained(case.character, nearest.noise, float(np.sqrt(squares[:, worst].mean())), float(np.sqrt(np.mean(means**2))))


def _loaded(scenario: Scenario, found: Qualification) -> Scenario:
    """The microscope with the recommended calibration, and loads."""
    specimen = scenario.specimen
    loads_n = [strain * specimen.youngs_modulus_gpa * 1e3 * specimen.area_mm2 for strain in STRAINS]
    shifts = [list(shift) for shift in found.protocol.shifts_px]
    protocol = {**scenario.experiment["protocol"], "calibration_shifts_px": shifts, "loads_n": loads_n, "hold_s": found.protocol.hold_s}
    return replace(scenario, seed=scenario.seed + RUN_SEED, experiment={**scenario.experiment, "protocol": protocol})


def _errors(folder: Path, shots: Sequence[ScannedFrame], scenario: Scenario, found: Qualification) -> Iterator[Array]:
    """(n, 3) error of exx, eyy and exy of the valid gauges within the grid, for each frame under load."""
    protocol = found.protocol
    correlation = DicSettings(subset_px=protocol.subset_px, step_px=protocol.step_px, roi_px=None)
    settings = AnalysisSettings(dic=correlation)
    settings = replace(settings, estimate=replace(settings.estimate, method="joint", window_points=protocol.window_points))
    state = None
    for pair in _pairs(folder, shots):
        state = state or pipeline.start(settings, pair.first)
        state = pipeline.accumulate(state, pair.decision, pipeline.correlate(state, pair))
    assert state is not None  # there are pairs
    solution = pipeline.solve(state)
    for shot in shots:
        if shot.stop.load_n is not None:
            field = pipeline.correct_frame(state, solution, shot.frame).strain
            yield _error(field, _true(shot, scenario), protocol.window_points // 2)


def _pairs(folder: Path, shots: Sequence[ScannedFrame]) -> Iterator[Pair]:
    frames = list_frames(folder, ScanProfile())
    for number in range(len(frames) // 2):
        first, second = (load_frame(frames[2 * number + member], 2 * number + member) for member in (0, 1))
        stop = shots[2 * number].stop
        phase = Phase.CALIBRATION if stop.load_n is None else Phase.TENSION
        step = Step(number, phase, (0.0, 0.0), stop.shift_px, stop.load_n)
        yield Pair(PairDecision(number, step, first.info, second.info, None), first, second)


def _error(field: StrainField, true: Array, half: int) -> Array:
    inner = np.s_[half:-half, half:-half]
    return (np.stack((field.exx, field.eyy, field.exy), axis=-1) - true)[inner][field.valid[inner]]


def _true(shot: ScannedFrame, scenario: Scenario) -> Array:
    """True exx, eyy and exy in the axes of the image, at the middle of a frame."""
    middle_s = np.array([shot.start_s + 0.5 * scenario.frame_duration_s])
    turn = scenario.scan.rotation
    gradient = turn.T @ shot.window.motion.at(middle_s).gradient[0] @ turn
    return np.array([gradient[0, 0], gradient[1, 1], 0.5 * (gradient[0, 1] + gradient[1, 0])])


def strained_rows(found: Sequence[Strained]) -> Iterator[tuple[str, bool]]:
    """Lines of the table by character and of all, each with whether the noise was predicted well enough."""
    for character in (*CHARACTERS, "all"):
        ratios = np.sort([one.ratio for one in found if character in (one.character, "all")])
        if len(ratios):
            near = int(np.sum(np.abs(ratios - 1.0) <= MAX_NOISE_ERROR))
            text = f"| {character} | {len(ratios)} | {near} | {np.median(ratios):.3f} | {ratios[0]:.3f} to {ratios[-1]:.3f} |"
            yield text, 0.95 * len(ratios) <= near or character != "all"
