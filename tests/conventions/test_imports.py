"""Every import contract is broken once on purpose, in a copy of the tree, and seen to fail."""

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
    ("drivers", "drivers/semlive_drivers/csv_load_file.py", "import semlive.formats.images.frames"),
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


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the packages and their contracts."""
    folder = tmp_path_factory.mktemp("tree")
    for name in ("semlive", "drivers", "simulators"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def broken_contracts(tree: Path) -> set[str]:
    """The contracts that lint-imports finds broken in a tree."""
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
    broken = {key for key, name in CONTRACTS.items() if verdicts[name] == "BROKEN"}
    assert (ran.returncode != 0) == bool(broken)
    return broken


def broken_by(copy: Path, file: str, statement: str) -> set[str]:
    """The contracts that break when a file of the copy gets one import more."""
    path = copy / file
    before = path.read_text("utf-8") if path.exists() else None
    new_folder = not path.parent.exists()
    path.parent.mkdir(exist_ok=True)
    path.write_text((before or "") + f"\n{statement}\n", "utf-8")
    try:
        return broken_contracts(copy)
    finally:
        if before is not None:
            path.write_text(before, "utf-8")
        elif new_folder:
            shutil.rmtree(path.parent)
        else:
            path.unlink()


def test_the_tree_keeps_its_contracts(copy: Path) -> None:
    assert broken_contracts(copy) == set()


@pytest.mark.parametrize(("contract", "file", "statement"), BREAKS)
def test_breaking_a_contract_is_seen(copy: Path, contract: str, file: str, statement: str) -> None:
    assert contract in broken_by(copy, file, statement)


@pytest.mark.parametrize(("file", "statement"), ALLOWED)
def test_what_the_house_allows_passes(copy: Path, file: str, statement: str) -> None:
    assert broken_by(copy, file, statement) == set()


def test_every_contract_is_tried() -> None:
    assert {contract for contract, _, _ in BREAKS} == set(CONTRACTS)
