"""The benchmark of a long log, in short."""

from __future__ import annotations

from pathlib import Path

from bench_replay import measured
from numexp.cases import CASES
from numexp.experiment import make_experiment

from semlive.data.grid import Grid


def test_a_longer_log_by_import_and_replay(tmp_path: Path) -> None:
    experiment = make_experiment(CASES["smooth"], 5, Grid(101, 101, 50, 15, 12, 0), calibration_pairs=4)
    *_, row = measured(experiment, 6, tmp_path, 1, None)  # two pairs more than the experiment has: they come again
    pairs, points, _, import_rate, _, replay_rate, _, peak_mb = (float(cell) for cell in row.strip("| ").split("|"))
    assert (pairs, points) == (6, 15 * 12)
    assert min(import_rate, replay_rate) > 0.0
    assert peak_mb < 1000
