"""A small folder of another engine's maps, with its truth, and the log that it becomes."""

from __future__ import annotations

from pathlib import Path

import pytest
from numexp.asfolder import write_folder
from numexp.cases import CASES
from numexp.experiment import Experiment, make_experiment

from semlive.data.grid import Grid
from semlive.data.settings import SpecimenSettings
from semlive.service.replay.import_maps import ImportRequest, import_folder

GRID = Grid(101, 101, 25, 30, 24, 0)
AREA_MM2 = 1.0


@pytest.fixture(scope="session")
def experiment() -> Experiment:
    """Five calibration pairs and seven load steps, on few points."""
    return make_experiment(CASES["tension"], 5, GRID, calibration_pairs=5)


@pytest.fixture(scope="session")
def folder(experiment: Experiment, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The experiment as a folder."""
    return write_folder(experiment, tmp_path_factory.mktemp("brought") / "tension", area_mm2=AREA_MM2)


@pytest.fixture(scope="session")
def imported(folder: Path) -> Path:
    """The folder as a log, its points stated to be independent."""
    log = folder.with_name("tension.mcap")
    import_folder(ImportRequest(folder, log, SpecimenSettings(area_mm2=AREA_MM2), subset_px=0))
    return log


@pytest.fixture(scope="session")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of four calibration pairs."""
    folder = tmp_path_factory.mktemp("short") / "short"
    write_folder(make_experiment(CASES["smooth"], 5, Grid(101, 101, 50, 15, 12, 0), calibration_pairs=4), folder)
    import_folder(ImportRequest(folder, folder.with_name("short.mcap"), subset_px=0))
    return folder.with_name("short.mcap")
