"""`semlive init` writes a configuration that can be run, with the unit of every number."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from semlive.cli.app import app
from semlive.data.clock import Clock
from semlive.errors import BadConfig, LinkRefused, SemliveError
from semlive.service.config.configuration import load_config, parse_config
from semlive.service.config.template import LAB_PRESETS, LabSetup, configuration_text
from semlive.service.runtime import drivers
from semlive.service.runtime.clock import SystemClock

ROOT = Path(__file__).resolve().parents[3]
UNITS = {"s", "um", "px", "px/s", "N", "N/s", "N/mm", "mm", "mm/s", "mm^2", "points"}
NUMBERED = {"host", "port", "unit"}
"""Keys whose numbers are names."""


def written(folder: Path, *arguments: str, typed: str | None = None) -> Any:
    return CliRunner().invoke(app, ["init", str(folder / "run.yaml"), *arguments], input=typed)


@pytest.mark.parametrize("lab", LAB_PRESETS)
def test_every_kind_of_lab_can_be_run(tmp_path: Path, lab: str) -> None:
    done = written(tmp_path, "--lab", lab, "--yes", "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout) == {"configuration": str(tmp_path / "run.yaml")}
    config = load_config(tmp_path / "run.yaml")
    assert len(config.plan().steps) == 12 + len(config.protocol.loads_n)
    assert config.load_frame is not None


@pytest.mark.checkout
@pytest.mark.parametrize("lab", LAB_PRESETS)
def test_the_examples_are_what_it_writes(lab: str) -> None:
    assert (ROOT / "deploy" / "examples" / f"{lab}.yaml").read_text(encoding="utf-8") == configuration_text(LAB_PRESETS[lab])


@pytest.mark.parametrize("lab", LAB_PRESETS)
def test_drivers_understand_their_settings(lab: str) -> None:
    config = parse_config(yaml.safe_load(configuration_text(LAB_PRESETS[lab])), lab)
    assert config.load_frame is not None
    assert config.stage is not None
    settings = dict(config.load_frame.settings)
    if "host" in settings:
        settings |= {"host": "127.0.0.1", "port": 1}  # no server listens there, which is reported after the settings are parsed
    clock = SystemClock(Clock(0, 0))
    if lab == "operator-deben":
        drivers.open_load_frame(config.load_frame.driver, settings, clock).close()
    else:
        with pytest.raises(LinkRefused):
            drivers.open_load_frame(config.load_frame.driver, settings, clock)
    drivers.open_stage(config.stage.driver, config.stage.settings, clock).close()


@pytest.mark.parametrize("lab", [*LAB_PRESETS.values(), LabSetup(frame="none", vendor="other"), LabSetup(stage="modbus", vendor="jeol")])
def test_every_number_reports_its_unit(lab: LabSetup) -> None:
    without = []
    for line in configuration_text(lab).splitlines():
        found = re.match(r"[ #]*(\w+): *([-\d.\[]+\d[^#:]*)(?:# (.*))?$", line)
        if found and found[1] not in NUMBERED and re.split("[, ]", found[3] or "")[0] not in UNITS:
            without.append(line)
    assert not without


def test_answers_are_requested_and_taken(tmp_path: Path) -> None:
    typed = "tried\n\ntescan\n0.5\nnone\nfoil\n\n"
    done = written(tmp_path, typed=typed)
    assert done.exit_code == 0, done.output
    config = load_config(tmp_path / "run.yaml")
    assert (config.run.name, config.sem.vendor, config.sem.pixel_size_um, config.load_frame) == ("tried", "tescan", 0.5, None)
    assert (config.specimen.name, config.protocol.loads_n) == ("foil", [])


def test_a_wrong_answer_is_requested_again_and_no_other_answer_is_lost(tmp_path: Path) -> None:
    typed = "cold rolled\ntried\n\ncanon\ntescan\n-1\n0.5\nmagnet\nnone\nfoil\nz\ny\n"
    done = written(tmp_path, typed=typed)
    assert done.exit_code == 0, done.output
    config = load_config(tmp_path / "run.yaml")
    assert (config.run.name, config.sem.vendor, config.sem.pixel_size_um, config.load_frame) == ("tried", "tescan", 0.5, None)
    for reason in (
        "cold rolled",
        "vendor canon: no such choice",
        "pixel_size_um must be more than 0",
        "frame magnet: no such choice",
        "loading_axis z",
    ):
        assert reason in done.output


def test_settings_given_as_options_are_not_prompted_for(tmp_path: Path) -> None:
    done = written(tmp_path, "--yes", "--max-load-n", "500", "--load-steps", "3", "--loading-axis", "x")
    assert done.exit_code == 0, done.output
    config = load_config(tmp_path / "run.yaml")
    assert config.protocol.loads_n == [50, 275, 500]
    assert config.specimen.loading_axis == "x"


@pytest.mark.parametrize(
    "text", ["42", "-1", "yes", "1e3", "0300", "null", "~", '6" sheet: a', "C:\\new", "# 1", "*a", "Blech, 1 mm", "Stück"]
)
def test_a_text_is_what_was_typed(tmp_path: Path, text: str) -> None:
    done = written(tmp_path, "--yes", f"--specimen={text}", f"--export-folder={text}")
    assert done.exit_code == 0, done.output
    config = load_config(tmp_path / "run.yaml")
    assert (config.specimen.name, config.sem.folder.name) == (text, Path(text).name)


@pytest.mark.parametrize(
    "wrong",
    [
        ("--lab", "moon"),
        ("--vendor", "canon"),
        ("--area-mm2", "-1"),
        ("--name", "a b"),
        ("--load-steps", "1"),
        ("--address", "host:99999"),
        ("--address", ""),
    ],
)
def test_wrong_answers_are_refused_and_nothing_is_written(tmp_path: Path, wrong: tuple[str, str]) -> None:
    done = written(tmp_path, "--yes", *wrong)
    assert isinstance(done.exception, SemliveError)
    assert not (tmp_path / "run.yaml").exists()


def test_a_file_that_is_there_stays(tmp_path: Path) -> None:
    (tmp_path / "run.yaml").write_text("mine")
    assert isinstance(written(tmp_path, "--yes").exception, BadConfig)
    assert (tmp_path / "run.yaml").read_text() == "mine"
    assert written(tmp_path, "--yes", "--force").exit_code == 0
