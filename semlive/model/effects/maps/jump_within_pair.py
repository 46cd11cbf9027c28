"""A permanent jump of the image between the two frames of a pair."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, Recurrence, Values, xy_parameters
from semlive.model.effects.run_geometry import RunGeometry, xy_columns


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """(u, v) = J from the second frame of a pair on."""
    later = np.broadcast_to((scene.frame >= values["first_frame"])[:, None], scene.time_s.shape)
    return BasisField(xy_columns(later.astype(np.float64)), xy_parameters("px"))


def grid(scene: RunGeometry) -> Iterable[Values]:
    """Every pair."""
    return ({"first_frame": float(frame)} for frame in scene.frame[scene.frame % 2 == 1])


FAMILY = EffectClass(
    "jump_within_pair",
    "the image jumps permanently between the two frames of a pair",
    basis_field,
    grid,
    group="G8",
    discriminating_experiment="a third frame in the pair",
    sizes_px=(0.003, 10.0),
    recurrence=Recurrence.ONE_TIME,
)
