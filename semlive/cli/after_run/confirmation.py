"""Confirmation of a diagnosis by simulation: the experiment is simulated without and with the identified effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import yaml

from semlive.cli.shared.output_path import output_folder, write_text
from semlive.cli.shared.simulated_run import simulated_run
from semlive.diagnose.simulation_comparison import Comparison, compare_with_simulations
from semlive.errors import BadInput
from semlive.service.diagnosis.model_scenario import scenario_yaml
from semlive.service.diagnosis.run import load_observation
from semlive.service.log.opened_log import OpenedLog

SEED = 611_953
"""Random seed of both simulations, in place of that of the scenario: their noise must differ from that of a measured run which was itself
simulated."""


@dataclass(frozen=True, slots=True)
class SimulationRequest:
    """Simulations for the confirmation of a diagnosis.

    Attributes:
        scenario: name of a simulator scenario with the protocol of the measured run, or a path ending in .yaml.
        folder: new folder; gets `without.yaml`, `with.yaml`, and the folders `without` and `with` of the runs.
    """

    scenario: str
    folder: Path


def new_folder(path: Path, option: str) -> Path:
    """Check the folder of the simulations before the work begins.

    Raises:
        BadInput: the folder is not empty, or cannot be made.
    """
    output_folder(path, option)
    if path.exists() and any(path.iterdir()):
        raise BadInput(f"{option} {path}: the folder is not empty; give a new folder")
    return path


def confirm(log: Path, model: Path, request: SimulationRequest, progress: Callable[[str, int, int], None] | None) -> Comparison:
    """Simulate the experiment of a scenario without and with the effects of a model, and compare both runs with the measured one.

    Both simulations run through the daemon on the simulated instrument, one after the other.

    Args:
        log: the measured run.
        model: model file of its diagnosis.
        request: scenario and folder.
        progress: called with the name of the stage, the finished part and the total.

    Raises:
        BadConfig: an effect of the model has no counterpart in the simulator.
        BadInput: no simulator is installed, the scenario does not exist, or its frames differ from those of the run.
        SemliveError: a simulated run was not completed.
    """
    scenario, folder = request.scenario, request.folder
    folder.mkdir(parents=True, exist_ok=True)
    base = str(Path(scenario).resolve()) if scenario.endswith((".yaml", ".yml")) else scenario
    without, with_effects = folder / "without.yaml", folder / "with.yaml"
    write_text(without, yaml.safe_dump({"extends": base, "seed": SEED}, sort_keys=False))
    write_text(with_effects, scenario_yaml(model, str(without.resolve())))
    logs = [simulated_run(str(path.resolve()), folder / path.stem) for path in (without, with_effects)]
    return compare_with_simulations(*(load_observation(opened, progress) for opened in map(OpenedLog, (log, *logs))))


def comparison_json(comparison: Comparison) -> dict[str, object]:
    """The fields of a comparison, and its conclusion."""
    return {**asdict(comparison), "confirmed": comparison.confirmed}


def comparison_text(comparison: Comparison) -> str:
    """The result of a comparison in three lines."""
    maps, sizes = comparison.maps, comparison.sizes
    return (
        f"{'confirmed' if comparison.confirmed else 'not confirmed'}, by {comparison.frames} maps of {comparison.blocks} blocks\n"
        f"measured less simulated maps: {maps.before_px:.4f} px without the effects, {maps.after_px:.4f} px with them, "
        f"{maps.floor_px:.4f} px is noise; {_percent(maps.closure, maps.interval)} closed\n"
        f"smooth and more than noise: {sizes.measured_px:.4f} px measured, {sizes.simulated_px:.4f} px simulated with them"
        + (f", {_percent(sizes.ratio, sizes.interval)} of it" if sizes.measured_px > 0.0 else "")
    )


def _percent(fraction: float, interval: tuple[float, float]) -> str:
    return f"{100 * fraction:.0f} % ({100 * interval[0]:.0f} to {100 * interval[1]:.0f} %)"
