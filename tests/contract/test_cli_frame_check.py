"""`semlive frame check`: looks at a bench over both lines, and moves and writes nothing."""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient

from semlive.cli.app import run_app
from semlive_drivers.maps import map_text
from semlive_simulators.load_frame.serial_lines import rtu_line
from semlive_simulators.load_frame.server import UNIT
from semlive_simulators.scenario import load_scenario

from .running_bench import running_bench


@pytest.fixture(scope="module")
def bench() -> Iterator[tuple[int, str]]:
    """TCP port and serial path of a bench on which nothing scans."""
    with running_bench(load_scenario("paper_x200"), 1.0) as parts, rtu_line(parts.port, UNIT, parts.registers.line_faults) as path:
        yield parts.port, path


Check = Callable[..., tuple[int, str, str]]


@pytest.fixture
def check(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Check:
    """The command, in this process: exit code, standard output, standard error."""

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["semlive", "frame", "check", *arguments])
        code = run_app()
        printed = capsys.readouterr()
        return code, printed.out, printed.err.strip()

    return run


@pytest.mark.parametrize("line", ["tcp", "rtu"])
def test_a_look_at_the_bench_finds_it_sound_and_writes_nothing(bench: tuple[int, str], check: Check, line: str) -> None:
    port, path = bench
    reach = ["--host", "127.0.0.1", "--port", str(port)] if line == "tcp" else ["--port", path, "--timeout-s", "1"]
    code, out, error = check("bench", *reach, "--json")
    assert code == 0, error
    found = json.loads(out)
    assert found["sound"]
    assert found["confirmed"]
    printed = {finding["what"]: finding for finding in found["findings"]}
    assert printed["identity"]["said"] == "0x5e31"
    assert printed["order of words"]["verdict"] == "good"
    assert printed["counter counts"]["verdict"] == "good"
    with ModbusTcpClient("127.0.0.1", port=port) as client:
        assert client.read_holding_registers(0, count=8, device_id=UNIT).registers == [0] * 8


def test_another_device_is_reported_in_a_table_and_by_the_exit_code(bench: tuple[int, str], check: Check) -> None:
    code, out, error = check("oriental_az", "--port", str(bench[0]))
    assert code == 1
    assert "bad" in out
    assert "confirm before motion" in " ".join(out.split())
    assert "Oriental Motor AZ" in error
    assert "checks failed" in error


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["laumas"], "no device description is called 'laumas'; there are bench"),
        (["bench", "--port", "1"], "no device answers at 127.0.0.1:1; check that the device is on"),
        (["bench", "--port", "ttyNone"], "ttyNone cannot be opened"),
        (["bench", "--force-reads", "about 3"], "--force-reads is 'about 3'; give the digits of the device's panel"),
    ],
)
def test_bad_input_gives_one_error_line(check: Check, arguments: list[str], sentence: str) -> None:
    code, out, error = check(*arguments)
    assert (code, out) == (2, "")
    assert error.startswith(sentence)
    assert len(error.splitlines()) == 1


def test_a_device_that_accepts_and_never_answers_gives_one_error_line(check: Check) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        code, out, error = check("bench", "--port", str(silent.getsockname()[1]), "--timeout-s", "0.2")
    assert (code, out) == (2, "")
    assert "gave no answer within 0.2 s" in error
    assert error.endswith("check cable and device, and that host, port and unit are its own")
    assert len(error.splitlines()) == 1


def test_a_map_of_ones_own_is_given_by_path(bench: tuple[int, str], check: Check, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    text = "protocol: modbus\nname: mine\nsource: mine\npoints: {limit: {kind: input, address: 14, dtype: f32, words: low_first}}\n"
    path.write_text(text + "plausible: {limit: [1, 10000]}\n", encoding="utf-8")
    code, _, error = check(str(path), "--port", str(bench[0]))
    assert code == 1
    assert error.startswith("mine at 127.0.0.1")


def test_a_map_of_ones_own_is_sound_only_with_what_the_panel_shows(bench: tuple[int, str], check: Check, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(map_text("bench"), encoding="utf-8")
    code, out, error = check(str(path), "--port", str(bench[0]), "--json")
    assert code == 1
    assert not json.loads(out)["sound"]
    assert "nothing disagrees with the description, but the readings are not proved" in error


def test_orders_that_the_device_cannot_hold_are_refused_before_any_run(bench: tuple[int, str], check: Check, tmp_path: Path) -> None:
    port, _ = bench
    reach = ["--host", "127.0.0.1", "--port", str(port)]
    code, out, error = check("bench", *reach, "--load", "100", "--load", "-20", "--rate", "5", "--json")
    assert code == 0, error
    printed = {finding["what"]: finding for finding in json.loads(out)["findings"]}
    assert printed["100 N at 5 N/s"]["verdict"] == "good"
    assert printed["-20 N at 5 N/s"]["verdict"] == "good"
    scaled = tmp_path / "scaled.yaml"
    target = "target: {kind: holding, address: 0, dtype: f32}"
    assert target in map_text("bench")
    scaled.write_text(map_text("bench").replace(target, "target: {kind: holding, address: 0, dtype: i16, scale: 0.01}"), encoding="utf-8")
    code, _, error = check(str(scaled), *reach, "--load", "100", "--load", "400", "--rate", "5")
    assert code == 1
    assert "400 N at 5 N/s: correct the load, the rate or the description" in error
    code, _, error = check("bench", *reach, "--load", "100")
    assert code == 2
    assert "--load needs --rate" in error
