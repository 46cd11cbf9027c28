"""Results of a method on an experiment, measured against the truth as in the table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numexp.experiment import Experiment, ObservedFrame
from numexp.world import Field

from semlive import mechanics
from semlive.data.disparity import DisparityMap
from semlive.data.drift import Correction, DistortionField
from semlive.data.experiment import Phase
from semlive.data.strain import Displacement

WINDOW_POINTS = 9


@dataclass(frozen=True, slots=True)
class Found:
    """What a method found.

    Attributes:
        distortion: on the grid; None if the method does not treat it.
        correct: the correction of a map from frame 0.
        magnification: relative change of the magnification between the middle of frame 0 and that of the last frame, or None.
        update_s: processor seconds of each pair's update.
        solve_s: processor seconds of one solution.
    """

    distortion: DistortionField | None
    correct: Callable[[DisparityMap], Correction]
    magnification: float | None = None
    update_s: tuple[float, ...] = ()
    solve_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Measured:
    """Errors of one method on one experiment; strain is (exx, eyy, exy).

    Attributes:
        distortion_max_px: largest error over the grid and both components, best affine map removed.
        mean_strain: (frames, 3) error of the mean strain of the noisy points.
        correction_mean_strain: (frames, 3) the same of the correction alone.
        correction_sd: (frames, 3) standard deviation over the field of the correction's strain error, 9 x 9 points.
        correction_max: largest strain error of the correction anywhere, 9 x 9 points.
        displacement_rms_px: of the correction, over points and frames, each frame's mean removed.
        load_step_strain: (steps, 3) error of each load step's mean strain, its two frames averaged.
        magnification: see `Found`.
        update_s: see `Found`.
        solve_s: see `Found`.
    """

    distortion_max_px: float
    mean_strain: Field
    correction_mean_strain: Field
    correction_sd: Field
    correction_max: float
    displacement_rms_px: float
    load_step_strain: Field
    magnification: float | None
    update_s: tuple[float, ...]
    solve_s: float

    def write(self, path: Path) -> None:
        """Into a file of arrays; a magnification that was not found is no number there."""
        np.savez(path, allow_pickle=False, **{name: np.asarray(value, dtype=np.float64) for name, value in asdict(self).items()})

    @classmethod
    def read(cls, path: Path) -> Measured:
        """What `write` wrote."""
        with np.load(path) as held:
            plain = {name: float(held[name]) for name in ("distortion_max_px", "correction_max", "displacement_rms_px", "solve_s")}
            fields = {name: held[name] for name in ("mean_strain", "correction_mean_strain", "correction_sd", "load_step_strain")}
            grown, update_s = float(held["magnification"]), tuple(held["update_s"].tolist())
        return cls(**plain, **fields, magnification=None if np.isnan(grown) else grown, update_s=update_s)


def measure(experiment: Experiment, found: Found) -> Measured:
    """All figures of the table for one method on one experiment."""
    noisy, mean, sd, largest, square, loaded = [], [], [], [], [], []
    for taken in experiment.pairs:
        of_pair = []
        for frame in taken.observed:
            measured = next(dmap for dmap in taken.maps if dmap.reference == 0 and dmap.current == frame.exact.current)
            of_pair.append(_mean_strain(mechanics.displacement(measured, found.correct(measured))) - _true_strain(frame))
            error = _error(frame, mechanics.displacement(frame.exact, found.correct(frame.exact)))
            mean.append(_mean_strain(error))
            field = mechanics.strain(error, WINDOW_POINTS)
            inside = np.stack([item[field.valid] for item in (field.exx, field.eyy, field.exy)])
            sd.append(inside.std(axis=1))
            largest.append(np.abs(inside).max())
            square.append(np.var(error.u_px[error.valid]) + np.var(error.v_px[error.valid]))
        noisy.extend(of_pair)
        if taken.phase is Phase.TENSION:
            loaded.append(np.mean(of_pair, axis=0))
    return Measured(
        distortion_error_px(experiment, found.distortion), np.array(noisy), np.array(mean), np.array(sd), float(max(largest)),
        float(np.sqrt(0.5 * np.mean(square))), np.array(loaded).reshape(-1, 3), found.magnification, found.update_s, found.solve_s,
    )  # fmt: skip


def distortion_error_px(experiment: Experiment, found: DistortionField | None) -> float:
    """Largest error of the distortion over the grid, its best affine map removed (translations do not determine it)."""
    if found is None:
        return float("nan")
    x, y = experiment.grid.mesh()
    error = np.stack((found.ex_px, found.ey_px), axis=-1) - experiment.world.bend_px(np.stack((x, y), axis=-1))
    plane = np.column_stack((np.ones(x.size), x.ravel(), y.ravel()))
    flat = error.reshape(-1, 2)
    return float(np.abs(flat - plane @ np.linalg.lstsq(plane, flat, rcond=None)[0]).max())


def _error(frame: ObservedFrame, found: Displacement) -> Displacement:
    truth_u, truth_v = frame.displacement_px[..., 0], frame.displacement_px[..., 1]
    return Displacement(
        found.frame, found.grid, np.where(found.valid, found.u_px - truth_u, 0.0), np.where(found.valid, found.v_px - truth_v, 0.0),
        found.sigma_u_px, found.sigma_v_px, found.valid,
    )  # fmt: skip


def _mean_strain(found: Displacement) -> Field:
    gradient, _ = mechanics.mean_gradient(found)
    return np.array([gradient[0, 0], gradient[1, 1], 0.5 * (gradient[0, 1] + gradient[1, 0])])


def _true_strain(frame: ObservedFrame) -> Field:
    g = frame.gradient
    return np.array([g[0, 0], g[1, 1], 0.5 * (g[0, 1] + g[1, 0])])
