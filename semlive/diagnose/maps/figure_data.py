"""Data for the figures of a verdict: maps before and after correction, time course and strain bias of each effect, residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from semlive.data.diagnosis.verdict import DiagnosisFigureData, EffectProfile, StrainBias
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.fit_tests.held_out_frames import held_out_residual
from semlive.model.effects import RunGeometry

Array = NDArray[np.float64]
FRAMES = 4
QUANTILES = 61
LOAD_CORRELATED = 0.9
"""Smallest correlation of an effect's time course with the load for a profile over load instead of time."""
MIN_STRAIN = 1e-7


def figure_data(
    without: HyperparameterGrid, baseline_with_effects: HyperparameterGrid, names: Sequence[str], fields: Sequence[Array]
) -> DiagnosisFigureData:
    """Figure data from a baseline without and with effects.

    Args:
        without: the baseline.
        baseline_with_effects: the baseline with the effects, whose columns come last.
        names: names of the identified effects.
        fields: for each effect, (f, b, 2, q) displacement of unit amplitudes, px.
    """
    columns = baseline_with_effects.design
    scene = columns.observation.geometry
    moved = _moved(baseline_with_effects, fields)
    shown = _shown(columns.whiten(np.sum(moved, axis=0)), scene)
    noise = columns.whiten.factor  # of unit variance
    residual = baseline_with_effects.residual()
    place = scene.address_px[0] + columns.observation.state.centre_px
    return DiagnosisFigureData(
        x_px=place[:, 0],
        y_px=place[:, 1],
        frame=tuple(int(value) for value in scene.frame[shown]),
        before=noise @ held_out_residual(without, shown),
        after=noise @ held_out_residual(baseline_with_effects, shown),
        profiles=tuple(_profile(baseline_with_effects, residual, name, value) for name, value in zip(names, moved, strict=True)),
        on_strain=tuple(_on_strain(scene, name, value) for name, value in zip(names, moved, strict=True)),
        quantiles=_quantiles(residual),
        frame_autocorrelation=_autocorrelation(residual),
    )


def _moved(baseline_with_effects: HyperparameterGrid, fields: Sequence[Array]) -> list[Array]:
    """(f, b, 2) displacement of each identified effect since frame 0, px; other effects of the baseline precede them."""
    amplitudes = baseline_with_effects.best.solve(baseline_with_effects.best.gradient[:, None])[:, 0]
    first, moved = len(amplitudes) - sum(field.shape[-1] for field in fields), []
    for field in fields:
        full = field @ amplitudes[first : first + field.shape[-1]]
        moved.append(full - full[0])
        first += field.shape[-1]
    return moved


def _shown(white: Array, scene: RunGeometry) -> NDArray[np.bool_]:
    """One frame of each pair with the largest displacement by effects; the pair of frame 0 is the reference."""
    size = np.sum(white**2, axis=(1, 2))
    best: dict[int, int] = {}
    for at in np.argsort(-size):
        pair = int(scene.pair[at])
        if pair != int(scene.pair[0]):
            best.setdefault(pair, int(at))
    shown = np.zeros(len(size), dtype=np.bool_)
    shown[list(best.values())[:FRAMES]] = True
    return shown


def _profile(baseline_with_effects: HyperparameterGrid, residual: Array, name: str, moved: Array) -> EffectProfile:
    """Amplitude, in each frame, of the shape the effect has at its maximum."""
    columns = baseline_with_effects.design
    scene, whiten = columns.observation.geometry, columns.whiten
    white = whiten(moved)
    largest = int(np.argmax(np.sum(white**2, axis=(1, 2))))
    shape = white[largest] / float(np.abs(moved[largest] - moved.mean(axis=0)).max())
    power = float(np.sum(shape**2))
    model = np.einsum("fbc,bc->f", white, shape) / power
    if model[largest] < model[0]:  # a growing effect has a rising profile
        shape, model = -shape, -model
    data = model + np.einsum("fbc,bc->f", residual, shape) / power
    load, on = scene.steps.load_n, scene.steps.loaded
    along = on.any() and np.ptp(load) > 0.0 and np.std(model) > 0.0 and abs(np.corrcoef(load, model)[0, 1]) > LOAD_CORRELATED
    sigma = np.full(len(model), power**-0.5)
    # Relative to frame 0, the reference of all displacements.
    return EffectProfile(name, "load" if along else "time", load if along else scene.start_s, data - model[0], sigma, model - model[0])


def _on_strain(scene: RunGeometry, name: str, moved: Array) -> StrainBias:
    """Mean strain by an effect in frames under load, and its slope over load relative to that of the maps."""
    if not scene.steps.loaded.any():
        return StrainBias(name, 0.0, 0.0, 0.0, None, None)
    own, observed = _gradients(scene, moved), _gradients(scene, scene.disparity_px)
    load = scene.steps.load_n
    top = int(np.argmax(np.abs(load)))
    exx, eyy, exy = (float(value) for value in own[top] - own[0])
    if np.ptp(load[scene.steps.loaded]) == 0.0 or np.abs(observed[top, :2]).max() < MIN_STRAIN:
        return StrainBias(name, exx, eyy, exy, None, None)
    line = np.stack((np.ones_like(load), load), axis=-1)[scene.steps.loaded]
    slope, of_all = (np.linalg.lstsq(line, value[scene.steps.loaded], rcond=None)[0][1] for value in (own, observed))
    axial = int(np.argmax(np.abs(of_all[:2])))
    corrected = of_all - slope
    modulus = of_all[axial] / corrected[axial] - 1.0
    ratio = -corrected[1 - axial] / corrected[axial] + of_all[1 - axial] / of_all[axial]
    return StrainBias(name, exx, eyy, exy, float(modulus), float(ratio))


def _gradients(scene: RunGeometry, moved: Array) -> Array:
    """(f, 3) exx, eyy and exy of the plane through each frame."""
    gradients = []
    for frame in range(len(scene.frame)):
        x, y = scene.address_px[frame].T
        _, u, v = np.linalg.lstsq(np.stack((np.ones_like(x), x, y), axis=-1), moved[frame], rcond=None)[0]
        gradients.append((u[0], v[1], 0.5 * (u[1] + v[0])))
    return np.array(gradients)


def _quantiles(residual: Array) -> Array:
    share = (np.arange(QUANTILES) + 0.5) / QUANTILES
    return np.stack((ndtri(share), np.quantile(residual, share)), axis=-1)


def _autocorrelation(residual: Array) -> tuple[float, float]:
    """Autocorrelation between frames, corrected for the common mean of -1 / (f - 1) caused by removal of the noise of frame 0."""
    f = len(residual)
    own = float(np.mean(residual[1:] * residual[:-1]) / np.mean(residual**2)) + 1.0 / (f - 1.0)
    return own, float((residual[1:].size) ** -0.5)
