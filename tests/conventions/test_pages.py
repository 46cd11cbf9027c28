"""What the pages show can be typed: every command line parses, the quick ones are run, every link leads somewhere."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import yaml
from scipy import ndimage
from typer.testing import CliRunner

sys.path.insert(0, str(Path(__file__).parent))
from shown import CASES, ELSEWHERE, ON_A_LOG, PAGES, ROOT

from semlive.cli.app import COMMANDS, app
from semlive.cli.lazy import load

RUN_HERE = re.compile(r"semlive (?:init|plan|inspect|doctor)\b")

pytestmark = pytest.mark.checkout


@pytest.fixture(scope="module")
def commands() -> dict[str, Any]:
    return {entry.name: load(entry) for entry in COMMANDS}


def test_there_are_many() -> None:
    assert len(CASES) > 70


def test_a_test_runs_each_of_them() -> None:
    assert {line.split()[0] for _, line in CASES if not line.startswith(("--", "COMMAND"))} <= {*ON_A_LOG, *ELSEWHERE}
    tests = ROOT / "tests"
    assert [name for name, path in ELSEWHERE.items() if f'"{name}"' not in (tests / path).read_text(encoding="utf-8")] == []


@pytest.mark.parametrize(("path", "line"), CASES, ids=[f"{path.name}-{line}" for path, line in CASES])
def test_a_shown_command_can_be_typed(path: Path, line: str, commands: dict[str, Any]) -> None:
    name, *given = shlex.split(line, posix="\\" not in line)
    if name in ("test", "lint", "docs", "COMMAND") or name.startswith("--"):
        assert name in ("test", "lint", "docs", "COMMAND", "--help", "--version", "--install-completion")
        return
    command = commands[name]
    if getattr(command, "commands", None):
        assert given, f"{path.name}: semlive {name} needs a command of its own"
        command = command.commands[given.pop(0)]
    options = {option for item in command.params for option in (*item.opts, *item.secondary_opts)} | {"--help"}
    unknown = [word for word in given if re.match(r"--?[a-z]", word) and word.split("=")[0] not in options]
    assert not unknown, f"{path.name}: semlive {name} has no {unknown}"


@pytest.mark.parametrize("path", [path for path in PAGES if path.suffix == ".md"], ids=lambda path: path.name)
def test_links_lead_somewhere(path: Path) -> None:
    text = re.sub(r"```.*?```|`[^`]*`", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    links = [link.split("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", text) if not link.startswith(("https:", "http:", "#"))]
    assert [link for link in links if not (path.parent / link).exists()] == []


@pytest.mark.parametrize("path", [path for path in PAGES if path.suffix == ".md"], ids=lambda path: path.name)
def test_anchors_are_headings(path: Path) -> None:
    text = re.sub(r"```.*?```|`[^`\n]*`", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    links = [link.split("#") for link in re.findall(r"\]\(([^)\s]*#[^)\s]+)\)", text) if not link.startswith(("https:", "http:"))]
    assert [f"{page}#{anchor}" for page, anchor in links if anchor not in anchors(path.parent / page if page else path)] == []


def anchors(path: Path) -> set[str]:
    """Of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_index_names_every_page() -> None:
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    pages = [path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md") if path.name != "README.md"]
    assert [page for page in pages if not page.startswith("decisions/") and f"({page})" not in index] == []


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder as the pages take it for granted: a test frame, and where the tutorial's first run exported."""
    rng = np.random.default_rng(2)
    speckle = ndimage.gaussian_filter(rng.standard_normal((884, 1024)), 2.5)
    image = np.clip(128 + 45 * speckle / speckle.std() + 4 * rng.standard_normal(speckle.shape), 0, 255).astype(np.uint8)
    export = tmp_path / "runs" / "first" / "instrument" / "export"
    export.mkdir(parents=True)
    for path in (tmp_path / "test.tif", export / "x200_0001.tif"):
        tifffile.imwrite(path, image, datetime=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", ["tutorials/first-run.md", "how-to/first-experiment.md", "how-to/new-sem.md", "how-to/deploy.md"])
def test_quick_commands_of_a_page_run_in_their_order(page: str, lab: Path) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    CliRunner().invoke(app, ["init", "my-run.yaml", "--yes"])
    config = yaml.safe_load((lab / "my-run.yaml").read_text(encoding="utf-8"))
    reported = {"row_time_s": 0.1071, "dwell_time_s": 1e-4, "pixel_size_m": 1.25e-6}  # a plain file has no metadata
    config["sem"]["profile"].update(reported)
    (lab / "my-run.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    lines = [line.strip() for line in re.findall(r"^ {4}(semlive .*)$", text, re.MULTILINE) if RUN_HERE.match(line)]
    assert lines
    for line in lines:
        words = shlex.split(line)[1:]
        if words[0] == "init":
            words = [*(word for word in words if word not in ("my-run.yaml", "--yes")), "another.yaml", "--yes", "--force"]
        done = CliRunner().invoke(app, words)
        # The instrument of the pages is not here, and a doctor that reports this does its work.
        assert done.exit_code == 0 or words[0] == "doctor", f"{line}: {done.output} {done.exception}"
