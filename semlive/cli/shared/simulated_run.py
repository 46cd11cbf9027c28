"""A simulated experiment through the daemon: simulated bench, configuration, and the run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from semlive.cli.shared.daemon_process import run_daemon
from semlive.cli.shared.simulator import running_simulator
from semlive.errors import BadInput, SemliveError

_PAIR_KEYS = ("calibration_shifts_px", "translation_shifts_px", "loads_n")
"""Keys of the protocol with one value for each pair."""
_SHIFTED: dict[str, dict[str, object]] = {"stage": {"kind": "specimen"}, "beam_shift": {"kind": "beam", "first_register": 400}}
"""Registers of the simulated bench that shift the field of view: those of the stage (the default of the driver) or of the beam shift."""


def daemon_config(bench: dict[str, Any], rate: float) -> dict[str, Any]:
    """The configuration of the daemon for a simulated bench.

    Args:
        bench: content of the `ready.json` of the bench: its addresses and the experiment of the scenario.
        rate: seconds of experiment per second of wall time.
    """
    link: dict[str, Any] = {"host": bench["host"], "port": bench["port"], "unit": bench["unit"]}
    stage = link
    if "rtu_port" in bench:
        link = {"serial": {"port": bench["rtu_port"]}, "unit": bench["unit"]}
        stage = {**link, "unit": bench["rtu_stage_unit"]}
    experiment = bench["experiment"]
    # A file on a local disk is complete after 0.1 s without change; a network share would need 2 s.
    sem = {"folder": bench["export_folder"], "poll_s": 0.05, "stable_for_s": 0.15, "profile": {"start_sigma_s": 0.01}}
    if bench["mode"] == "triggered":
        sem["trigger"] = {"driver": "modbus", "settings": link}
    # Three minutes of wall time: the analysis reports when a frame was scanned, and on a busy computer it may be some pairs behind.
    protocol = {"frame_timeout_s": max(900.0, 180.0 * rate), **experiment["protocol"]}
    return {
        "run": {"name": "demo", "folder": "log", "clock_file": bench["clock_file"]},
        "sem": {**sem, **experiment["sem"]},
        "load_frame": {"driver": "modbus", "poll_s": min(0.05, 1.0 / rate), "settings": {**link, **experiment.get("load_frame", {})}},
        "stage": {"driver": "modbus", "poll_s": min(0.1, 2.0 / rate), "settings": {**stage, **_SHIFTED[bench["shifts_by"]]}},
        **{key: section for key, section in experiment.items() if key not in ("sem", "protocol", "load_frame")},
        "protocol": protocol,
    }


def require_pairs(bench: dict[str, Any], pairs: int) -> None:
    """Refuse an experiment of another length than that of a measured run.

    Args:
        bench: content of the `ready.json` of the bench.
        pairs: number of pairs of the measured run.

    Raises:
        BadInput: the experiment plans another number of pairs.
    """
    protocol = bench["experiment"]["protocol"]
    planned = sum(len(protocol.get(key, ())) for key in _PAIR_KEYS)
    if planned != pairs:
        raise BadInput(f"the scenario has {planned} pairs and the measured run {pairs}; give a scenario with the protocol of that run")


def simulated_run(scenario: str, folder: Path, pairs: int) -> Path:
    """Run the experiment of a scenario on the simulated instrument; returns the folder of its log.

    Args:
        scenario: name of a scenario, or the path of one.
        folder: new or empty folder for all files; messages of the daemon go to `daemon.txt` in it.
        pairs: number of pairs that the scenario must have, so that the run is no longer than the measured one.

    Raises:
        BadInput: no simulator is installed, the scenario does not exist, or it has another number of pairs.
        SemliveError: the simulator did not start, or the run was not completed.
    """
    with running_simulator(scenario, folder / "instrument", None) as bench:
        require_pairs(bench, pairs)
        config, messages = folder / "run.yaml", folder / "daemon.txt"
        config.write_text(yaml.safe_dump(daemon_config(bench, bench["rate"]), sort_keys=False), encoding="utf-8")
        with messages.open("wb") as output:
            code = run_daemon(config, "--stop-on-fault", output=output)
    if code != 0:
        raise SemliveError(f"the simulated run in {folder} ended with exit code {code}; see {messages}")
    return folder / "log" / "demo"
