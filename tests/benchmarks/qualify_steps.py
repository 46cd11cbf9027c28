"""The further steps of a qualification through the daemon: each with the scan that the step names, joined with the first run.

Scan rotation, rows, dwell time and magnification of the simulated instrument are those of the step. The true values of the figures that
relate both runs follow from the scenario.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml
from qualify_daemon import SLOW, run_semlive

import semlive_simulators
from semlive.cli.shared.simulated_run import daemon_config
from semlive.cli.shared.simulator import running_simulator
from semlive.qualify.further import DWELL_FACTOR, proposals
from semlive.qualify.values import Qualification, SetupFigures
from semlive.service.qualification.files import read_qualification
from semlive_simulators.scenario import Scenario, load_scenario


@dataclass(frozen=True, slots=True)
class Planned:
    """The steps of one scenario.

    Attributes:
        name: of the scenario.
        rate: seconds of experiment per second of wall time. The pause between triggered frames scatters with it, and thus the row time.
        steps: names of the steps.
        stage: what its stage has instead.
    """

    name: str
    rate: float
    steps: tuple[str, ...]
    stage: Mapping[str, float] = field(default_factory=dict)


PLANNED = (
    Planned("qualify_slow_settling", 20.0, ("dwell", "magnified")),
    Planned("qualify_wrong_row_time", 2.0, ("rows",)),
    Planned("qualify_good", 20.0, ("turned",), {"nonorthogonality_rad": 0.05}),  # a stage that is oblique beyond its interval
)
SETUP_NOISE = "noise_43"


@dataclass(frozen=True, slots=True)
class StepRun:
    """A further step, joined with the first run.

    Attributes:
        scenario: name of the scenario.
        step: name of the step.
        proposed: names of the steps that the first run needs.
        remaining: names of the steps that both need.
        pairs: number of pairs of the step that are in the result.
        figures: figure, true value, lower and upper end, of those that relate both runs.
    """

    scenario: str
    step: str
    proposed: tuple[str, ...]
    remaining: tuple[str, ...]
    pairs: int
    figures: tuple[tuple[str, float, float, float], ...]

    @property
    def good(self) -> bool:
        """Whether the step was proposed and done, and every interval contains the truth."""
        inside = all(low <= true <= high for _, true, low, high in self.figures)
        return self.step in self.proposed and self.step not in self.remaining and bool(self.figures) and inside


def step_rows() -> Iterator[tuple[str, bool]]:
    """Lines of the table of the steps, each with whether it was proposed and done, and its figures contain their true values."""
    for planned in PLANNED:
        with TemporaryDirectory(prefix="semlive-") as folder:
            for run in _runs(planned, Path(folder)):
                figures = "; ".join(f"`{figure}` {true:.5g} in {low:.5g} to {high:.5g}" for figure, true, low, high in run.figures)
                proposed, remaining = (", ".join(names) or "none" for names in (run.proposed, run.remaining))
                yield f"| `{run.scenario}` | {proposed} | `{run.step}` | {run.pairs} | {figures} | {remaining} |", run.good


def _runs(planned: Planned, work: Path) -> Iterator[StepRun]:
    first = _taken(planned, work / "first", None)
    found = _qualified(work / "first.json", first)
    for step in planned.steps:
        log = _taken(planned, work / step, step)
        both = _qualified(work / f"{step}.json", first, log)
        (setup,) = both.setups
        truth = true_relations(load_scenario(planned.name), step)
        figures = {figure.name: (figure.low, figure.high) for figure in setup.figures}
        if step == "dwell":
            figures["noise_ratio"] = _noise_ratio(setup, both)
        stated = tuple((key, true, *figures[key]) for key, true in truth.items() if key in figures)
        yield StepRun(planned.name, step, _needed(found), _needed(both), setup.pairs, stated)


def true_relations(scenario: Scenario, step: str) -> dict[str, float]:
    """True values of the figures that relate a step to the first run."""
    if step == "rows":
        errors = [getattr(effect, "row_time_error", 0.0) for effect in scenario.effects.members]
        return {"row_time_ratio": 1.0 + sum(errors)}
    if step == "dwell":
        return {"noise_ratio": DWELL_FACTOR**-0.5}
    same = {"scan_turn_error": 0.0, "pixel_size_ratio": 1.0}
    return same if step == "magnified" else {**same, "scan_aspect": 1.0, "scan_shear": 0.0}


def _noise_ratio(setup: SetupFigures, both: Qualification) -> tuple[float, float]:
    """Interval of the noise of the step over that of the first run, which has half of the dwell time."""
    step, first = (next(figure for figure in found.figures if figure.name == SETUP_NOISE) for found in (setup, both))
    relative = float(np.linalg.norm([0.5 * (noise.high - noise.low) / noise.value for noise in (step, first)]))
    return step.value / first.value * (1.0 - relative), step.value / first.value * (1.0 + relative)


def _qualified(path: Path, *logs: Path) -> Qualification:
    run_semlive("qualify", *(argument for log in logs for argument in ("--from", log)), "--quick", "-o", path)
    return read_qualification(path)


def _needed(found: Qualification) -> tuple[str, ...]:
    return tuple(proposal.step.name.value for proposal in proposals(found))


def _taken(planned: Planned, work: Path, step: str | None) -> Path:
    """The log of a run of the daemon with the scan of a step; the first run without one."""
    work.mkdir()
    scenario, lab, plan = work / "scenario.yaml", work / "lab.yaml", work / "plan.yaml"
    given = yaml.safe_load((files(semlive_simulators) / "scenarios" / f"{planned.name}.yaml").read_text(encoding="utf-8"))
    given["stage"] = {**given.get("stage", {}), **planned.stage}
    scenario.write_text(yaml.safe_dump({**given, **_changes(load_scenario(planned.name), step)}), encoding="utf-8")
    with running_simulator(str(scenario), work / "bench", planned.rate, triggered=True) as bench:
        config = json.loads(json.dumps(daemon_config(bench, planned.rate)))
        config["stage"]["settings"]["timeout_s"] = 4.0
        config["limits"].update(SLOW)
        lab.write_text(yaml.safe_dump(config), encoding="utf-8")
        run_semlive("qualify", lab, *(() if step is None else ("--step", step)), "--protocol", plan)
        run_semlive("run", plan, "--no-page", "--stop-on-fault")
    (log,) = (work / "log").iterdir()
    return log


def _changes(scenario: Scenario, step: str | None) -> dict[str, dict[str, float]]:
    """What a step changes in the simulated instrument."""
    scan, detector = scenario.scan, scenario.detector
    if step == "rows":
        rows = scan.height_px // 2
        return {"scan": {"height_px": rows, "frame_time_s": scan.row_time_s * rows}}
    if step == "dwell":
        slower = {"dwell_time_s": DWELL_FACTOR * scan.dwell_time_s, "frame_time_s": DWELL_FACTOR * scan.duration_s}
        # The simulated detector has its noise per pixel, whatever the dwell time.
        quieter = {"read_noise": detector.read_noise * DWELL_FACTOR**-0.5, "shot_noise": detector.shot_noise / DWELL_FACTOR}
        return {"scan": slower, "detector": quieter}
    if step == "turned":
        return {"scan": {"rotation_rad": scan.rotation_rad + 0.5 * float(np.pi)}}
    return {"scan": {"pixel_size_um": 0.5 * scan.pixel_size_um}} if step == "magnified" else {}
