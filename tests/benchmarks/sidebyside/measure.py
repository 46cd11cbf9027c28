"""From a run folder to the figures that are compared with the paper's."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sidebyside.field import compared, on_papers_points
from sidebyside.neighbours import exported_frame, noise_correlation

from semlive import dic, mechanics
from semlive.data.disparity import DisparityMap
from semlive.data.experiment import Phase
from semlive.data.frame import FrameInfo
from semlive.data.results import FrameResult, RunResult
from semlive.data.settings import AnalysisSettings
from semlive.data.strain import Displacement, ElasticConstants
from semlive.errors import BadInput
from semlive.formats.log.maps import decode_map
from semlive.formats.log.messages import DIC_MAP
from semlive.report.noise_propagation import NoiseCorrelation, effective_sample_size, gauge_rows, noise_scatter
from semlive.report.scoring.errors import COMPONENTS, RunErrors, compare_with_truth
from semlive.report.scoring.score import Score, score
from semlive.report.scoring.truth import Truth, average_over_subset, load_truth, true_motion
from semlive.service.log.files import messages
from semlive.service.replay.replay import result_from_maps

Field = NDArray[np.float64]
FIELDS = ("u", "v", *COMPONENTS)


@dataclass(frozen=True)
class GaugeRow:
    """One gauge length of one phase; every value is the rms over the phase's frames, dictionaries are keyed by FIELDS."""

    window_points: int
    vsg_px: int
    measured: dict[str, float]  # scatter over the field
    predicted: dict[str, float]  # the same from the DIC's own noise alone
    correction: dict[str, float]  # scatter of the error of drift and distortion correction, alone
    chance: float  # standard deviation of measured / predicted that chance allows

    def ratio(self, name: str) -> float:
        return self.measured[name] / self.predicted[name]


@dataclass(frozen=True)
class PhaseFigures:
    """Mean strain over the field of one phase's frames, (frames, 3)."""

    error: Field
    sigma: Field
    correction: Field  # the correction's share in it
    uncorrected: Field  # from the raw disparity
    curve: tuple[GaugeRow, ...]


@dataclass(frozen=True)
class RunFigures:
    """Everything of one run that the table needs."""

    frames: int
    points: int
    errors: RunErrors
    scores: tuple[Score, ...]
    elastic: ElasticConstants | None
    true_elastic: tuple[float, float]
    stated_sigma_px: float
    noise_floor_px: float
    displacement_rms_px: float
    correction_rms_px: float
    phases: dict[str, PhaseFigures]


def measure(run: Path, windows: tuple[int, ...]) -> RunFigures:
    """Measure a run folder of ``semlive demo``.

    Raises:
        BadInput: it is not one.
    """
    log, truth_file = run / "log" / "demo", run / "instrument" / "truth.json"
    if not log.is_dir():
        raise BadInput(f"{run}: holds no log/demo; give a folder that semlive demo wrote")
    reported = load_truth(truth_file)
    truth = Truth.of(reported)
    whole, settings = result_from_maps(log)
    result = compared(whole)
    errors = compare_with_truth(result, truth)
    shares = dict(_shares(log, result, truth))
    phases = {
        phase.value: _phase(result, errors, shares, phase, windows, _equal_noise(log, result, settings, phase))
        for phase in Phase
        if any(one.phase is phase for one in errors.frames)
    }
    sigma = [one.sigma_px[one.valid] for one in errors.frames]
    grid = errors.grid
    return RunFigures(
        frames=len(result.frames),
        points=grid.nx * grid.ny,
        errors=errors,
        scores=score(whole, reported),
        elastic=result.elastic,
        true_elastic=(truth.youngs_modulus_gpa, truth.poissons_ratio),
        stated_sigma_px=_rms(np.concatenate(sigma)),
        noise_floor_px=errors.noise_floor_px,
        displacement_rms_px=_rms(np.concatenate([one.displacement_px[one.valid] for one in errors.frames])),
        correction_rms_px=_rms(
            np.concatenate([share[frame.valid] for frame, (share, _) in zip(errors.frames, shares.values(), strict=True)])
        ),
        phases=phases,
    )


def _equal_noise(log: Path, result: RunResult, settings: AnalysisSettings, phase: Phase) -> NoiseCorrelation:
    """Of frame 0 and the phase's middle pair: drift smears frames of one phase less than those of another."""
    pairs = [one for one in result.decisions if one.step.phase is phase]
    chosen = (result.decisions[0], pairs[len(pairs) // 2])
    images = (exported_frame(log, one.first.export, settings).image for one in chosen)
    first, second = (dic.blur_of_pair(one, _within(log, one.pair)) for one in chosen)
    return noise_correlation(*images, result.frames[0].displacement.grid, settings, dic.missing_blur(first, second))


def _within(log: Path, pair: int) -> DisparityMap:
    """The map from the first to the second frame of a pair."""
    maps = (decode_map(message.payload) for message in messages(log) if message.topic == DIC_MAP)
    return next(one for one in maps if (one.reference, one.current) == (2 * pair, 2 * pair + 1))


def _shares(log: Path, result: RunResult, truth: Truth) -> Iterator[tuple[int, tuple[Field, DisparityMap]]]:
    """For every frame but 0: (ny, nx, 2) error of what was subtracted, less its mean, and the map it was subtracted from."""
    infos = {2 * one.pair + member: info for one in result.decisions for member, info in enumerate((one.first, one.second))}
    moved = {one.summary.frame: one.displacement for one in result.frames}
    for message in messages(log):
        if message.topic != DIC_MAP:
            continue
        disparity = on_papers_points(decode_map(message.payload))
        if disparity.reference != 0:
            continue
        corrected = moved[disparity.current]
        valid = disparity.valid & corrected.valid  # beyond the calibrated addresses the correction is extrapolated and marked
        given = np.stack((disparity.u_px - corrected.u_px, disparity.v_px - corrected.v_px), axis=-1)
        address = np.stack(disparity.grid.mesh(), axis=-1)
        # Displacement is disparity less correction, so what the correction has too little the displacement has too much. Maps, and
        # the correction learnt from them, show what bends within a subset by its mean.
        info, subset_px = infos[disparity.current], disparity.grid.subset_px
        share = average_over_subset(partial(_correction, truth, infos[0], info), address, subset_px) - given
        share = np.where(valid[..., None], share - share[valid].mean(axis=0), 0.0)
        yield disparity.current, (share, disparity)


def _correction(truth: Truth, first: FrameInfo, info: FrameInfo, address: Field) -> Field:
    return true_motion(truth, first, info, address).correction_px


def _phase(
    result: RunResult,
    errors: RunErrors,
    shares: dict[int, tuple[Field, DisparityMap]],
    phase: Phase,
    windows: tuple[int, ...],
    shared_noise: NoiseCorrelation,
) -> PhaseFigures:
    chosen = [one for one in errors.frames if one.phase is phase]
    frames = {one.summary.frame: one for one in result.frames}
    corrections = {one.frame: _as_displacement(frames[one.frame], shares[one.frame][0]) for one in chosen}
    raw = [replace(frames[one.frame].displacement, u_px=d.u_px, v_px=d.v_px) for one in chosen for d in [shares[one.frame][1]]]
    residual = {one.frame: _as_displacement(frames[one.frame], one.displacement_px) for one in chosen}
    printed = np.sqrt(np.mean([(one.sigma_px[one.valid] ** 2).mean(axis=0) for one in chosen], axis=0))
    rows = []
    for points in windows:
        expected = noise_scatter(errors.grid, points, float(printed[0]), float(printed[1]), full=True, correlation=shared_noise)
        values = effective_sample_size(errors.grid, points) * len(chosen) / (1 + (len(chosen) - 1) / 4)
        rows.append(
            GaugeRow(
                points,
                errors.grid.vsg_px(points),
                _scatter(((residual[one.frame], frames[one.frame].displacement) for one in chosen), points),
                {name: getattr(expected, name) for name in FIELDS},
                _scatter(((corrections[one.frame], corrections[one.frame]) for one in chosen), points),
                float(1 / np.sqrt(2 * values)),
            )
        )
    return PhaseFigures(
        np.array([one.mean_strain - one.true_strain for one in chosen]),
        np.array([one.mean_sigma for one in chosen]),
        np.array([_mean_strain(one) for one in corrections.values()]),
        np.array([_mean_strain(one) - own.true_strain for one, own in zip(raw, chosen, strict=True)]),
        tuple(rows),
    )


def _as_displacement(frame: FrameResult, value_px: Field) -> Displacement:
    return replace(frame.displacement, u_px=np.ascontiguousarray(value_px[..., 0]), v_px=np.ascontiguousarray(value_px[..., 1]))


def _mean_strain(one: Displacement) -> list[float]:
    mean = mechanics.summary(one, mechanics.strain(one, 3)).mean
    return [mean.exx, mean.eyy, mean.exy]


def _scatter(frames: Iterable[tuple[Displacement, Displacement]], points: int) -> dict[str, float]:
    """Scatter over the complete gauges of each frame, rms over frames: averaged displacement of the first, strain of the second."""
    variances: dict[str, list[float]] = {name: [] for name in FIELDS}
    half, rows = points // 2, None
    for averaged, strained in frames:
        grid, valid = averaged.grid, averaged.valid
        rows = rows or tuple(gauge_rows(count, points, full=True) for count in (grid.ny, grid.nx))
        (mean_y, _), (mean_x, _) = rows
        count = mean_y @ valid.astype(np.float64) @ mean_x.T
        whole = valid[half : grid.ny - half, half : grid.nx - half] & (count > 0.5)
        for name, value in (("u", averaged.u_px), ("v", averaged.v_px)):
            variances[name].append(float(np.var((mean_y @ np.where(valid, value, 0.0) @ mean_x.T)[whole] / count[whole])))
        for name, values in _strains(strained, points, rows).items():
            variances[name].append(float(np.var(values)))
    return {name: float(np.sqrt(np.mean(one))) for name, one in variances.items()}


def _strains(one: Displacement, points: int, rows: tuple[tuple[Field, Field], ...]) -> dict[str, Field]:
    """Strain at the complete gauges; where no point is missing the plane fit separates, which is the same and forty times faster."""
    if one.valid.all():
        (mean_y, slope_y), (mean_x, slope_x) = rows
        xx, yy = mean_y @ one.u_px @ slope_x.T, slope_y @ one.v_px @ mean_x.T
        xy = 0.5 * (slope_y @ one.u_px @ mean_x.T + mean_y @ one.v_px @ slope_x.T)
        return {name: value / one.grid.step_px for name, value in zip(COMPONENTS, (xx, yy, xy), strict=True)}
    field, half = mechanics.strain(one, points), points // 2
    inside = np.zeros_like(field.valid)
    inside[half : one.grid.ny - half, half : one.grid.nx - half] = True
    return {name: getattr(field, name)[inside & field.valid] for name in COMPONENTS}


def _rms(values: Field) -> float:
    return float(np.sqrt(np.mean(values**2)))
