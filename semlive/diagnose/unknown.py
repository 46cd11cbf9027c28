"""Effects without a name: fields that are smooth in every frame, of any course in time. They explain anything and name nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.noise import modes
from semlive.model.effects import Family, Law, Scene
from semlive.model.effects.family import Values

SIZES_PX = (3e-4, 1.0)  # hundreds of amplitudes at once; none of them need be large
FINE = 7  # order of the polynomials of a field that all frames of a kind share


def _each_frame(scene: Scene, values: Values) -> Law:
    """A field of its own for every frame."""
    del values
    f, b = scene.time_s.shape
    shapes = modes(scene)
    columns = np.zeros((f, b, 2, f * shapes.shape[-1] * 2))
    place = np.arange(shapes.shape[-1])
    for frame in range(f):
        for axis in (0, 1):
            columns[frame, :, axis, (2 * frame + axis) * len(place) + place] = shapes[frame].T
    return Law(columns, scatter=("rms_px", "px", 1.0))


def _growing(scene: Scene, values: Values) -> Law:
    """A finer field that grows with time, one that comes and goes with every other frame, and one that grows with the load."""
    del values
    shapes = modes(scene, FINE)
    course: list[NDArray[np.float64]] = [scene.time_s / scene.end_s, np.where(scene.frame % 2 == 0, 1.0, -1.0)[:, None]]
    if scene.load.any():
        course.append(scene.load)
    nothing = np.zeros_like(shapes)
    fields = [shapes * np.broadcast_to(one, scene.time_s.shape)[..., None] for one in course]
    columns = [np.stack(pair, axis=2) for one in fields for pair in ((one, nothing), (nothing, one))]
    return Law(np.concatenate(columns, axis=-1), scatter=("rms_px", "px", 1.0))


UNNAMED: tuple[Family, ...] = (
    Family("smooth_field_of_each_frame", "a smooth field of its own in every frame", _each_frame, sizes_px=SIZES_PX),
    Family("field_with_a_course", "a finer field that grows with time or load, or alternates", _growing, sizes_px=SIZES_PX),
)
