"""The model forwards: effects and their parameters to predicted positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import FrameTime
from semlive.kernels.splines.spline_columns import evaluate_curve, evaluate_surface
from semlive.model.distortion import DistortionSpline
from semlive.model.drift import DriftSpline
from semlive.model.effect import Axis, Columns, Effect, FrameObservation, Layout, TensorColumns
from semlive.model.raster_time import sighting

ITERATIONS = 8  # distortion gradients are below 2e-2, so each pass gains two digits


def predicted_offsets(model: Sequence[Effect], parameters: NDArray[np.float64], observation: FrameObservation) -> NDArray[np.float64]:
    """(n, 2) sum of all effects on the ideal position: ``R - p_0``."""
    layout = Layout.of(model)
    observation = evaluate_drift(model, parameters, observation)
    total = np.zeros((len(observation.x_px), 2))
    for effect in model:
        own = parameters[layout.part(effect.name)]
        for columns in effect.columns(observation):
            if columns.axis is Axis.EACH:
                total += _both(columns, own.reshape(-1, 2))
            else:
                total[:, int(columns.axis is Axis.Y)] += np.sum(columns.value * own[columns.index], axis=1)
    return total


def _both(columns: Columns | TensorColumns, own: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) contribution of columns that act on x and y, with parameters (k, 2)."""
    if isinstance(columns, TensorColumns):
        return evaluate_surface(columns.index_y, columns.value_y, columns.index_x, columns.value_x, own.reshape(*columns.shape, 2))
    return evaluate_curve(np.ascontiguousarray(columns.index), np.ascontiguousarray(columns.value), np.ascontiguousarray(own))


def evaluate_drift(model: Sequence[Effect], parameters: NDArray[np.float64], observation: FrameObservation) -> FrameObservation:
    """The observation with the drift at its points, if the drift advects the distortion of the model; else unchanged."""
    drift = next((effect for effect in model if isinstance(effect, DriftSpline)), None)
    if (
        drift is None
        or observation.drift_px is not None
        or not any(isinstance(effect, DistortionSpline) and effect.carried for effect in model)
    ):
        return observation
    return replace(observation, drift_px=predicted_offsets((drift,), parameters[Layout.of(model).part(drift.name)], observation))


def scan_address(
    model: Sequence[Effect], parameters: NDArray[np.float64], when: FrameTime, p0_px: NDArray[np.float64], centre_px: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n, 2) scan addresses in a frame of the material points with ideal positions `p0_px` (n, 2) in pair 0.

    The effects depend on the address and on its scan time, so the address is determined by iteration.
    """
    address = p0_px
    for _ in range(ITERATIONS):
        observation = sighting(when, address[:, 0], address[:, 1], p0_px - centre_px)
        address = p0_px + predicted_offsets(model, parameters, observation)
    return address
