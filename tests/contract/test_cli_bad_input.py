"""Bad input: one clear message on standard error, exit code 2, nothing moved."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from semlive.service.log.files import messages

Printed = tuple[int, str, str]


def run(tmp_path: Path, config: dict[str, Any]) -> str:
    path = tmp_path / "run.yaml"
    path.write_text(yaml.safe_dump(config))
    return refused(path)


def refused(config: Path) -> str:
    """Output of a refused run; in a process of its own, because a run changes how its process gets memory."""
    done = subprocess.run([sys.executable, "-m", "semlive", "run", str(config)], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1, done.stderr
    return done.stderr


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.fixture
def config(tmp_path: Path) -> dict[str, Any]:
    (tmp_path / "export").mkdir()
    return {
        "run": {"name": "try", "folder": "log"},
        "sem": {"folder": "export", "pixel_size_um": 1.25},
        "stage": {"driver": "null"},
        "protocol": {"calibration_shifts_px": [[0, 0], [8, 0]]},
    }


def test_a_wrong_key_is_named_with_the_right_one(tmp_path: Path, config: dict[str, Any]) -> None:
    config["protocol"]["hold_sec"] = 30
    printed = run(tmp_path, config)
    assert "run.yaml" in printed
    assert "protocol.hold_sec" in printed
    assert "did you mean hold_s?" in printed


def test_a_missing_folder_is_named(tmp_path: Path, config: dict[str, Any]) -> None:
    config["sem"]["folder"] = "nowhere"
    printed = run(tmp_path, config)
    assert str(tmp_path / "nowhere") in printed
    assert "correct the path" in printed


def test_a_refused_socket_is_named(tmp_path: Path, config: dict[str, Any]) -> None:
    port = free_port()
    config["load_frame"] = {"driver": "modbus", "settings": {"host": "127.0.0.1", "port": port}}
    config["limits"] = dict.fromkeys(("force_max_n", "extension_max_mm", "force_rate_max_n_s", "force_step_max_n"), 1.0)
    config["limits"].update(force_min_n=0.0, extension_min_mm=0.0, stage_travel_um=100.0)
    printed = run(tmp_path, config)
    assert f"127.0.0.1:{port}" in printed
    assert "check" in printed
    # Nothing has moved: the log holds the fault alone, and the same run can be started once the cable is in.
    assert run(tmp_path, config) == printed
    topics = [message.topic for message in messages(tmp_path / "log" / "try")]
    assert topics.count("/fault") == 1
    assert "/load_frame/sample" not in topics


def test_an_unknown_driver_is_named_with_those_there_are(tmp_path: Path, config: dict[str, Any]) -> None:
    config["stage"]["driver"] = "teleport"
    printed = run(tmp_path, config)
    assert "teleport" in printed
    assert "operator" in printed


def test_a_real_machine_asks_for_somebody_at_the_instrument(tmp_path: Path, config: dict[str, Any]) -> None:
    config["stage"]["driver"] = "operator"
    assert "--attended" in run(tmp_path, config)


def test_a_missing_configuration_is_named(tmp_path: Path) -> None:
    assert "absent.yaml" in refused(tmp_path / "absent.yaml")


@pytest.mark.parametrize("command", [("replay",), ("report",), ("score", "--truth", "x.json")])
def test_a_missing_log_is_named(tmp_path: Path, command: tuple[str, ...], semlive: Callable[..., Printed]) -> None:
    code, _, err = semlive(command[0], str(tmp_path / "absent.mcap"), *command[1:])
    assert code == 2
    assert "absent.mcap" in err
    assert err.count("\n") == 1


def test_an_unreadable_image_is_named(tmp_path: Path, semlive: Callable[..., Printed]) -> None:
    for name in ("a.tif", "b.tif"):
        (tmp_path / name).write_bytes(b"II*\x00 this is no image")
    code, _, err = semlive("dic", str(tmp_path / "a.tif"), str(tmp_path / "b.tif"), "--json")
    assert code == 2
    assert "a.tif" in err
    assert err.count("\n") == 1


def test_an_unknown_scenario_is_named_with_those_there_are(tmp_path: Path, semlive: Callable[..., Printed]) -> None:
    code, _, err = semlive("demo", "--scenario", "moon", "--out", str(tmp_path / "out"))
    assert code == 2
    assert "moon" in err
    assert "paper_x200" in err
    assert list(tmp_path.iterdir()) == []
