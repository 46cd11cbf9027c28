"""Every import contract is broken on purpose, in a copy of the tree, and each forbidden import is found by its contract."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sysconfig
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOTS = (".", "drivers", "simulators")
CONTRACTS = {c["id"]: c["name"] for c in tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]}

# contract, file of the copy to add or extend, what it imports against the rules
BREAKS = [
    ("layers", "semlive/errors.py", "import semlive.data.grid"),
    ("layers", "semlive/data/broken.py", "import semlive.formats"),
    ("layers", "semlive/inputs/broken.py", "import semlive.data.grid"),
    ("layers", "semlive/formats/broken.py", "import semlive.ports"),
    ("layers", "semlive/ports.py", "import semlive.formats"),
    ("layers", "semlive/kernels/broken.py", "import semlive.model"),
    ("layers", "semlive/model/broken.py", "import semlive.dic"),
    ("layers", "semlive/dic/broken.py", "import semlive.estimate"),
    ("layers", "semlive/estimate/broken.py", "import semlive.mechanics"),
    ("layers", "semlive/mechanics/broken.py", "import semlive.dic"),
    ("layers", "semlive/engine/broken.py", "import semlive.pipeline"),
    ("layers", "semlive/pipeline/broken.py", "import semlive.service"),
    ("layers", "semlive/service/broken.py", "import semlive.report"),
    ("layers", "semlive/report/broken.py", "import semlive.cli"),
    ("layers", "semlive/new_room/__init__.py", "import semlive.errors"),  # a room that no layer names
    ("layers", "semlive/report/broken.py", "import semlive.api"),
    ("layers-formats", "semlive/formats/vendors/broken.py", "import semlive.formats.log.writer"),
    ("layers-joint", "semlive/estimate/joint/elimination/broken.py", "import semlive.estimate.joint.solution.posterior"),
    ("layers-kernels", "semlive/kernels/splines/broken.py", "import semlive.kernels.subset_matching.icgn"),
    ("layers-kernels", "semlive/kernels/threads.py", "import semlive.kernels.arrays"),
    ("layers-dic", "semlive/dic/global_method/broken.py", "import semlive.dic.correlate"),
    ("layers-dic", "semlive/dic/bands/broken.py", "import semlive.dic.image_quality.quality"),
    ("layers-diagnose", "semlive/diagnose/baseline/broken.py", "import semlive.diagnose.maps.search"),
    ("layers-diagnose", "semlive/diagnose/rows/broken.py", "import semlive.diagnose.intensity.verdict"),
    ("layers-service", "semlive/service/storage/broken.py", "import semlive.service.log.recording"),
    ("layers-service", "semlive/service/analysis/broken.py", "import semlive.service.control.control"),
    ("layers-cli", "semlive/cli/after_run/broken.py", "import semlive.cli.during_run.run"),
    ("layers-cli", "semlive/cli/shared/broken.py", "import semlive.cli.lazy"),
    ("no-plugins", "semlive/service/broken.py", "import semlive_drivers.modbus"),
    ("no-plugins", "semlive/cli/broken.py", "import semlive_simulators"),
    ("no-inverse-crime", "simulators/semlive_simulators/broken.py", "import semlive.model"),
    ("no-inverse-crime", "simulators/semlive_simulators/broken.py", "import semlive.ports"),
    ("no-inverse-crime", "simulators/semlive_simulators/effects/broken.py", "from semlive import kernels"),
    ("no-inverse-crime", "simulators/semlive_simulators/broken.py", "import semlive_drivers"),
    ("drivers", "drivers/semlive_drivers/broken.py", "import semlive.formats"),
    ("drivers", "drivers/semlive_drivers/modbus/broken.py", "import semlive.service"),
    ("drivers", "drivers/semlive_drivers/broken.py", "import semlive_simulators"),
    ("drivers", "drivers/semlive_drivers/broken.py", "import semlive.process_lock"),
    ("drivers", "drivers/semlive_drivers/load_file/part.py", "import semlive.formats.images.frames"),
    ("layers", "semlive/process_lock.py", "import semlive.ports"),
    ("light-control", "semlive/service/control/broken.py", "import semlive.estimate"),
    ("light-control", "semlive/service/device_link/broken.py", "import scipy.linalg"),
    ("light-control", "semlive/service/daemon/broken.py", "import semlive.service.analysis.worker"),
    ("pure", "semlive/engine/broken.py", "import time"),
    ("pure", "semlive/dic/broken.py", "import os.path"),
    ("pure", "semlive/estimate/broken.py", "import logging"),
    ("pure", "semlive/mechanics/broken.py", "import tifffile"),
    ("pure", "semlive/model/broken.py", "import asyncio"),
    ("pure", "semlive/kernels/broken.py", "import socket"),
    ("pure", "semlive/data/broken.py", "import mcap.reader"),
    ("pure-spine", "semlive/pipeline/broken.py", "import time"),
    ("numba", "semlive/dic/broken.py", "import numba"),
    ("numba", "simulators/semlive_simulators/broken.py", "from numba import njit"),
    ("numba", "drivers/semlive_drivers/broken.py", "import numba"),
]
ALLOWED = [
    ("simulators/semlive_simulators/broken.py", "import semlive.errors, semlive.data.grid, semlive.formats, semlive.inputs.files"),
    (
        "drivers/semlive_drivers/broken.py",
        "import semlive.errors, semlive.data.grid, semlive.inputs.kinds, semlive.ports, socket, time",
    ),
    ("drivers/semlive_drivers/endpoint_lock.py", "import semlive.process_lock, semlive.endpoints"),
    ("semlive/kernels/broken.py", "import numba"),
    ("simulators/semlive_simulators/kernels/broken.py", "import numba"),
    ("semlive/service/broken.py", "import asyncio, os, socket, time, logging, mcap, semlive.pipeline, semlive.ports"),
]

pytestmark = pytest.mark.checkout


def copy_to(folder: Path) -> Path:
    """A copy of the packages and their contracts."""
    for name in ("semlive", "drivers", "simulators"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def planted(copy: Path, number: int, file: str, statement: str) -> str:
    """Add an import to a file of the copy; a new file gets the number into its name.

    Returns:
        The beginning of the line in which lint-imports reports the import: its module.
    """
    path = copy / (file if (ROOT / file).exists() or file.endswith("__init__.py") else file.replace("broken", f"broken_{number}"))
    path.parent.mkdir(exist_ok=True)
    path.write_text((path.read_text("utf-8") if path.exists() else "") + f"\n{statement}\n", "utf-8")
    module = path.relative_to(copy).with_suffix("").parts
    return ".".join(part for part in module if part not in (*ROOTS, "__init__"))


def lint(tree: Path) -> dict[str, str]:
    """The violations that lint-imports prints for each broken contract of a tree."""
    path = os.pathsep.join(str(tree / root) for root in ROOTS)
    ran = subprocess.run(
        [Path(sysconfig.get_path("scripts")) / "lint-imports", "--no-cache", "--no-logo"],
        cwd=tree,
        env=os.environ | {"PYTHONPATH": path, "COLUMNS": "500", "NO_COLOR": "1", "PYTHONUTF8": "1"},
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=60,
    )
    verdicts = dict(re.findall(r"^(.+) (KEPT|BROKEN)\b", ran.stdout, re.MULTILINE))
    assert set(verdicts) == set(CONTRACTS.values()), ran.stdout + ran.stderr
    broken = {key: name for key, name in CONTRACTS.items() if verdicts[name] == "BROKEN"}
    assert (ran.returncode != 0) == bool(broken)
    parts = re.split(r"^(.+)\n-+\n", ran.stdout, flags=re.MULTILINE)  # what precedes the first title, then titles and texts in turn
    texts = dict(zip(parts[1::2], parts[2::2], strict=True))
    return {key: texts[name] for key, name in broken.items()}


@pytest.fixture(scope="module")
def violations(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, str], list[str]]:
    """What lint-imports prints, by contract, for a copy with all of `BREAKS`, and the module of each of them."""
    copy = copy_to(tmp_path_factory.mktemp("broken"))
    modules = [planted(copy, number, file, statement) for number, (_, file, statement) in enumerate(BREAKS)]
    return lint(copy), modules


def test_the_tree_keeps_its_contracts(tmp_path: Path) -> None:
    assert lint(copy_to(tmp_path)) == {}


@pytest.mark.parametrize("number", range(len(BREAKS)), ids=lambda number: "-".join(BREAKS[number]))
def test_breaking_a_contract_is_reported(violations: tuple[dict[str, str], list[str]], number: int) -> None:
    printed, modules = violations
    contract, _, statement = BREAKS[number]
    imported = re.escape(statement.replace("from semlive import ", "import semlive.").split()[1].split(".")[0])
    assert re.search(rf"^\W*{re.escape(modules[number])}( -> {imported}\b|$)", printed[contract], re.MULTILINE)


def test_allowed_imports_pass(tmp_path: Path) -> None:
    copy = copy_to(tmp_path)
    for number, (file, statement) in enumerate(ALLOWED):
        planted(copy, number, file, statement)
    assert lint(copy) == {}


def test_every_contract_is_tried() -> None:
    assert {contract for contract, _, _ in BREAKS} == set(CONTRACTS)
