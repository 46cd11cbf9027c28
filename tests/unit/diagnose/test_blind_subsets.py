"""Displacements of the blind set as means over subsets: exact for what varies slowly, and a jump as a mean over rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from blind.cases import Case
from blind.experiment import Conditions, Subsets
from blind.nuisance import GRIDS, NUISANCES, under

from semlive.data.grid import Grid
from semlive.model.effects import DRIFT_JUMP, RunGeometry

GRID = Grid(101, 101, 15, 8, 12, 43)
BLOCK_PX, ROW_S = 116.0 + 45.0 * np.arange(13), 0.1071


@pytest.mark.parametrize("step_px", [5, 15, 60])
def test_means_of_a_plane_are_its_values(step_px: int) -> None:
    grid = Grid(101, 101, step_px, 4, 5, 43)
    subsets = Subsets.of(grid, 43)
    places = np.stack(grid.mesh(), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(subsets.mean(subsets.places), places, atol=1e-9)


def test_a_jump_is_a_mean_over_the_rows() -> None:
    """A row is 0.107 s; a jump is displaced by less than two rows."""
    subsets = Subsets.of(GRID, 43)
    y = GRID.mesh()[1].ravel()
    for jump_px in np.arange(150.0, 200.0, 1.7):
        later = np.repeat((subsets.places[:, 1:] > jump_px).astype(np.float64), 2, axis=1)
        share = np.clip((y - jump_px) / 45.0 + 0.5, 0.0, 1.0)
        assert np.max(np.abs(subsets.mean(later)[:, 0] - share)) < 1.6 / 45.0


def test_each_nuisance_changes_the_data_or_the_points() -> None:
    plain = Conditions(3)
    unchanged = {name for name in NUISANCES if under(name, plain) == plain}
    assert unchanged == {*GRIDS, "any size"}
    assert under("", plain) == plain


def test_pauses_move_starts_and_sizes_are_drawn() -> None:
    starts_s = [Conditions(3, pause_s=300.0).begin_s(frame) - Conditions(3).begin_s(frame) for frame in range(5)]
    assert starts_s[0] == 0.0
    assert np.all(np.diff(starts_s) > 0.0)
    keys = {Case("one", ("stage_yaw",), 4.0, 1, under=name).key for name in ("", *NUISANCES)}
    assert len(keys) == 1 + len(NUISANCES)


def jump_geometry(subset_s: float) -> RunGeometry:
    """13 rows of blocks of three points, 45 rows apart."""
    nothing: Any = np.zeros((1, len(BLOCK_PX), 2))
    none: Any = None
    time_s, frame = BLOCK_PX[None] * ROW_S, np.zeros(1, dtype=np.int64)
    return RunGeometry(
        nothing, nothing, np.zeros(1, dtype=bool), time_s, time_s, np.zeros_like(time_s), nothing, nothing, 512.0, 442.0, frame, frame,
        np.zeros(1), none, 1.0, 1.0, subset_s=subset_s,
    )  # fmt: skip


@pytest.mark.parametrize(("subset_s", "error_s"), [(0.0, 0.3), (43 * ROW_S, 0.1)])
def test_the_instant_of_a_jump_needs_the_rows_of_the_subsets(subset_s: float, error_s: float) -> None:
    """Fitted instants of a jump in means over blocks of subsets. Rows of the generator are 0.32 s apart, an error of 0.09 s rms."""
    subsets, scene, errors_s = Subsets.of(Grid(101, 101, 15, 1, 39, 43), 43), jump_geometry(subset_s), []
    for jump_px in np.arange(300.0, 345.0, 3.0):
        later = np.repeat((subsets.places[:, 1:] > jump_px).astype(np.float64), 2, axis=1)
        true = subsets.mean(later)[:, 0].reshape(-1, 3).mean(axis=1)
        tried_s = ROW_S * jump_px + np.arange(-1.0, 1.0, 0.01)
        fields = [DRIFT_JUMP.basis_field(scene, {"at_s": float(at_s)}) for at_s in tried_s]
        misfit = [np.sum((field.field_px[0, :, 0, 0] - true) ** 2) for field in fields if field is not None]
        errors_s.append(tried_s[int(np.argmin(misfit))] - ROW_S * jump_px)
    rms_s = float(np.sqrt(np.mean(np.square(errors_s))))
    assert rms_s < error_s
    assert rms_s > 0.15 or subset_s > 0.0


@pytest.mark.parametrize("name", ["", "random pauses", "half the dwell", "short plan"])
@pytest.mark.parametrize("seed", [300_001, 300_005, 300_006])
def test_a_jump_occurs_during_a_frame_whatever_the_condition(name: str, seed: int) -> None:
    """Between frames it is a rigid motion, which no map shows: two such cases were counted as effects that were not found."""
    case = Case("one", ("drift_jump",), 4.0, seed, under=name)
    (jump,), conditions = case.effects(), case.conditions()
    begin_s = [conditions.begin_s(frame) for frame in range(2 * (conditions.calibration + conditions.tension))]
    fractions = [(jump.at_s - at_s) / conditions.scan.frame_time_s for at_s in begin_s]
    assert sum(0.19 < fraction < 0.71 for fraction in fractions) == 1
