"""Whether the daemon would accept the plan of a benchmark's scenario, without running it: in milliseconds instead of minutes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from semlive.cli.shared.simulated_run import daemon_config
from semlive.engine import start
from semlive.service.config.configuration import parse_config
from semlive_simulators.scenario import load_scenario


def check_plan(scenario: str, rate: float, change: Callable[[dict[str, Any]], dict[str, Any]] = lambda config: config) -> None:
    """Raise what the daemon would raise for the plan of a scenario.

    Args:
        scenario: text of the scenario, YAML.
        rate: seconds of experiment per second of wall time.
        change: what the benchmark does with the configuration of the bench.

    Raises:
        BadScenario: the simulator refuses the scenario.
        BadConfig: the daemon refuses the configuration.
        BadInput: the plan breaks its limits.
    """
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "scenario.yaml"
        path.write_text(scenario, encoding="utf-8")
        loaded = load_scenario(str(path))
        bench = {
            "host": "127.0.0.1",
            "port": 502,
            "unit": 1,
            "export_folder": name,
            "clock_file": str(Path(name) / "clock.json"),
            "mode": "continuous",
            "shifts_by": loaded.shifts_by.value,
            "experiment": loaded.experiment,
        }
        start(parse_config(change(daemon_config(bench, rate)), "run.yaml").plan(), 0)
