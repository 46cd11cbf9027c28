"""Unnamed fields: smooth fields and time courses without a physical cause, as alternatives to named effects.

Each is as simple as possible. An effect missing from the dictionary must be more likely as an unnamed field than as a named effect that
fits it. Fields that grow with the load are excluded, because they are strain and belong to named effects.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.baseline.noise_scale import modes
from semlive.model.effects import BasisField, EffectClass, RunGeometry
from semlive.model.effects.effect_class import Values
from semlive.model.effects.run_geometry import exponential_decay, field_column, slow_gaussian_process, times_time_columns, xy_columns

Array = NDArray[np.float64]

SIZES_PX = (3e-4, 1.0)  # hundreds of amplitudes, each of which may be small
POLYNOMIAL_ORDERS = 3  # order of the polynomials of a smooth field
WAVES, COARSE = 9, 8.0  # half waves of a finer field, and the squared wave number above which the prior amplitude decreases
POWERS = (1.0, 2.0)
# Linear maps (x, y) -> (u, v): magnification, rotation, aspect, skew; then each matrix element; the y column; the x column.
LINEAR = (
    (((1, 0), (0, 1)),),
    (((0, -1), (1, 0)),),
    (((1, 0), (0, -1)),),
    (((0, 1), (1, 0)),),
    (((1, 0), (0, 0)),),
    (((0, 1), (0, 0)),),
    (((0, 0), (1, 0)),),
    (((0, 0), (0, 1)),),
    (((0, 1), (0, 0)), ((0, 0), (0, 1))),
    (((1, 0), (0, 0)), ((0, 0), (1, 0))),
)


def _each_frame(scene: RunGeometry, values: Values) -> BasisField:
    """An independent field for every frame."""
    del values
    f, b = scene.time_s.shape
    shapes = modes(scene)
    columns = np.zeros((f, 2, shapes.shape[-1], 2, f, b))
    for frame in range(f):
        for axis in (0, 1):
            columns[frame, axis, :, axis, frame] = shapes[frame].T
    return BasisField(
        columns.reshape(-1, 2, f, b).transpose(2, 3, 1, 0), random_amplitude=("rms_px", "px", 1.0)
    )  # a tenth of a gigabyte, in the order of later access


def _plain(scene: RunGeometry) -> Array:
    """(f, b, k) polynomials."""
    return modes(scene, POLYNOMIAL_ORDERS)


def _fine(scene: RunGeometry) -> Array:
    """(f, b, k) cosines with amplitudes decreasing with frequency, for example for a bump or the edge of a band."""
    low, high = scene.address_px.min(axis=(0, 1)), scene.address_px.max(axis=(0, 1))
    x, y = np.moveaxis((scene.address_px - low) / (high - low), -1, 0)
    waves = [(i, j) for i in range(WAVES) for j in range(WAVES - i) if i + j]
    return np.stack([np.cos(np.pi * i * x) * np.cos(np.pi * j * y) / (1.0 + (i * i + j * j) / COARSE) ** 2 for i, j in waves], axis=-1)


def _going(shapes: Array, course: Array) -> BasisField:
    """Shapes (f, b, k) along x and along y, each multiplied by time courses (f, b or 1, c)."""
    f, b, _ = shapes.shape
    along = (shapes[..., None] * course[:, :, None, :]).reshape(f, b, -1)
    nothing = np.zeros_like(along)
    columns = [np.stack(pair, axis=2) for pair in ((along, nothing), (nothing, along))]
    return BasisField(np.concatenate(columns, axis=-1), random_amplitude=("rms_px", "px", 1.0))


def _growing(scene: RunGeometry, values: Values) -> BasisField:
    """A field proportional to a power of time."""
    shapes = _fine(scene) if values["fine"] else _plain(scene)
    return _going(shapes, ((scene.time_s / scene.end_s) ** values["power"])[..., None])


def _powers(scene: RunGeometry) -> Iterable[Values]:
    del scene
    return ({"power": power, "fine": fine} for power in POWERS for fine in (0.0, 1.0))


def _wandering(scene: RunGeometry, values: Values) -> BasisField:
    """A field whose components vary slowly and independently."""
    del values
    return _going(_plain(scene), slow_gaussian_process(scene.time_s))


def _alternating(scene: RunGeometry, values: Values) -> BasisField:
    """A field that alternates between frames."""
    del values
    return _going(_fine(scene), np.where(scene.frame % 2 == 0, 1.0, -1.0)[:, None, None])


def _linear(scene: RunGeometry, values: Values) -> BasisField:
    """A linear map that varies slowly."""
    course, columns = slow_gaussian_process(scene.time_s), []
    for (ux, uy), (vx, vy) in LINEAR[int(values["map"])]:
        columns.append(times_time_columns(field_column(ux * scene.x + uy * scene.y, vx * scene.x + vy * scene.y), course))
    return BasisField(np.concatenate(columns, axis=-1), random_amplitude=("rms_px", "px", 1.0))


def _maps(scene: RunGeometry) -> Iterable[Values]:
    del scene
    return ({"map": float(place)} for place in range(len(LINEAR)))


def _after_steps(scene: RunGeometry, values: Values) -> BasisField:
    """An exponential decay of the image position after every step, with an independent amplitude each."""
    each = (scene.pair[:, None] == np.unique(scene.pair)).astype(np.float64)
    fall = exponential_decay(scene, each, values["time_constant_s"])
    return BasisField(
        np.concatenate([xy_columns(value) for value in np.moveaxis(fall, -1, 0)], axis=-1), random_amplitude=("rms_px", "px", 1.0)
    )


def _constants(scene: RunGeometry) -> Iterable[Values]:
    del scene
    return ({"time_constant_s": float(value)} for value in np.geomspace(8.0, 400.0, 6))


UNNAMED_CLASSES: tuple[EffectClass, ...] = (
    EffectClass("smooth_field_of_each_frame", "an independent smooth field in every frame", _each_frame, sizes_px=SIZES_PX),
    EffectClass("field_that_grows", "a smooth field that grows with time, or with its square", _growing, _powers, sizes_px=SIZES_PX),
    EffectClass("field_that_wanders", "a smooth field that varies slowly and randomly", _wandering, sizes_px=SIZES_PX),
    EffectClass("field_of_every_other_frame", "a smooth field that alternates between frames", _alternating, sizes_px=SIZES_PX),
    EffectClass(
        "rest_after_every_step",
        "an exponential decay of the image position after every step, with independent amplitudes",
        _after_steps,
        _constants,
    ),
    EffectClass("linear_map_that_wanders", "stretch, shear or rotation that varies slowly and randomly", _linear, _maps, sizes_px=SIZES_PX),
)
