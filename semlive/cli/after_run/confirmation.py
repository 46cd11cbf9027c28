"""Confirmation of a diagnosis by simulation: the experiment is simulated without and with the identified effects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import yaml

from semlive.cli.shared.output_path import output_folder, write_text
from semlive.cli.shared.simulated_run import simulated_run
from semlive.data.diagnosis.effects import Outcome
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.data.strain import MeasuredValue
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.residual_channels import ChannelResidual, measured_channels
from semlive.diagnose.simulation_comparison import Comparison, Proof, compare_with_simulations
from semlive.errors import BadInput
from semlive.service.diagnosis.model_scenario import scenario_yaml
from semlive.service.diagnosis.run import load_observation
from semlive.service.log.opened_log import OpenedLog

SEED = 611_953
"""Random seed of both simulations, in place of that of the scenario: their noise must differ from that of a measured run which was itself
simulated."""


_NOT_ADDED = {
    Outcome.UNKNOWN: "an effect is missing that is not in the dictionary, and the closest one is not the cause",
    Outcome.REJECTED: "the held-out pairs contradict the best effect",
}


@dataclass(frozen=True, slots=True)
class SimulationRequest:
    """Simulations for the confirmation of a diagnosis.

    Attributes:
        scenario: name of a simulator scenario with the protocol of the measured run, or a path ending in .yaml.
        folder: new folder; gets `model.json`, `without.yaml`, `with.yaml`, and the folders `without` and `with` of the runs.
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


def prove(
    diagnosis: Diagnosis,
    observation: Observation,
    log: Path,
    write: Callable[[Path], None],
    request: SimulationRequest,
    progress: Callable[[str, int, int], None] | None,
) -> Proof:
    """Simulate the experiment of a scenario without and with the identified effects, and compare both runs with the measured one.

    Both simulations run through the daemon on the simulated instrument, one after the other, with as many pairs as the measured run. If no
    effect was identified, nothing is simulated, and the gap is the residual of the measured maps.

    Args:
        diagnosis: verdict on the measured run.
        observation: its observation.
        log: its log.
        write: writes the model with the identified effects to a path.
        request: scenario and folder.
        progress: called with the name of the stage, the finished part and the total.

    Raises:
        BadConfig: an effect of the model has no counterpart in the simulator.
        BadInput: no simulator is installed, the scenario does not exist, or its pairs or frames differ from those of the run.
        SemliveError: a simulated run was not completed.
    """
    pairs = diagnosis.run.pairs[1]
    reason = "no effect was identified" if not diagnosis.effects else _NOT_ADDED.get(diagnosis.outcome, "")
    if reason:
        return Proof(pairs, measured_channels(observation, diagnosis.model_effects), reason=reason)
    scenario, folder = request.scenario, request.folder
    base = str(Path(scenario).resolve()) if scenario.endswith((".yaml", ".yml")) else scenario
    model, without, with_effects = folder / "model.json", folder / "without.yaml", folder / "with.yaml"
    write(model)
    write_text(without, yaml.safe_dump({"extends": base, "seed": SEED}, sort_keys=False))
    write_text(with_effects, scenario_yaml(model, str(without.resolve())))
    logs = [simulated_run(str(path.resolve()), folder / path.stem, pairs) for path in (without, with_effects)]
    comparison = compare_with_simulations(*(load_observation(opened, progress) for opened in map(OpenedLog, (log, *logs))))
    return Proof(pairs, comparison.channels, tuple(effect.name for effect in diagnosis.effects), comparison)


def proof_json(proof: Proof, page: Path) -> dict[str, object]:
    """The keys of a confirmation in the JSON object of a diagnosis."""
    return {
        "proof": None if proof.comparison is None else comparison_json(proof.comparison),
        "residual": {
            "pairs": proof.pairs,
            "added": list(proof.added),
            "nothing_added": proof.reason or None,
            "channels": [asdict(item) for item in proof.channels],
            "page": str(page),
        },
    }


def proof_text(proof: Proof) -> str:
    """The result of a confirmation, one line for the comparison and one for each channel."""
    if proof.comparison is None:
        head = f"nothing was added and nothing was simulated: {proof.reason}; the gap as measured:"
    else:
        head = f"simulation with {', '.join(proof.added)}: {comparison_text(proof.comparison)}"
    return "\n".join((head, *map(_channel_text, proof.channels)))


def _channel_text(item: ChannelResidual) -> str:
    after = "" if item.after is None else f"{_value(item.after)} after, "
    return f"{item.channel}: {_value(item.before)} before, {after}{_value(item.expected)} by noise alone, in units of the noise"


def _value(quantity: MeasuredValue) -> str:
    return f"{quantity.value:.3f} +- {quantity.sigma:.3f}"


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
