"""Effects that are known before: they join the baseline, and what they move can be taken off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from semlive.data.diagnosis import KnownEffect
from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.diagnose.baseline import Found, Ladder, ladder
from semlive.diagnose.noise import quiet
from semlive.diagnose.observation import Observation
from semlive.diagnose.strain_safety import HARMLESS, eaten
from semlive.errors import BadInput
from semlive.model.effects import DICTIONARY, Family

Array = NDArray[np.float64]


def family_of(name: str) -> Family:
    """A family by its name.

    Raises:
        BadInput: nothing has that name.
    """
    found = next((one for one in DICTIONARY if one.name == name), None)
    if found is None:
        raise BadInput(f"model: no effect is called {name}; the known ones are {', '.join(one.name for one in DICTIONARY)}.")
    return found


def showing(observation: Observation, known: Sequence[KnownEffect]) -> list[KnownEffect]:
    """Those that a run can show: some go with loads or moves."""
    return [one for one in known if family_of(one.name).law(observation.scene, dict(one.values)) is not None]


def joined(bare: Ladder, known: Sequence[KnownEffect]) -> tuple[Ladder, tuple[Array, ...]]:
    """The baseline with effects in it, whose amplitudes the data refit, and (f, b, 2, q) what unit amplitudes of each move in px.

    Raises:
        BadInput: an effect is unknown, or cannot be in these data.
    """
    columns, fields = bare.design, []
    for one in known:
        law = family_of(one.name).law(columns.observation.scene, dict(one.values))
        if law is None:
            raise BadInput(f"model: {one.name} cannot be seen in this run: it has no loads or moves to go with.")
        columns = columns.having(Found(columns.whiten(law.field_px), one.size_px))
        fields.append(law.field_px)
    return (ladder(columns) if known else bare), tuple(fields)


def amplitudes_of(having: Ladder) -> Array:
    """(r,) most likely amplitudes of the effects in a baseline, at its likeliest smoothness."""
    return np.asarray(having.best.solve(having.best.pull[:, None])[len(having.design.kept) :, 0])


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """What effects move.

    Attributes:
        effects: their names.
        field_px: (f, b, 2) since frame 0, all of them together.
        left_in: names of those that are strain, look like it, or would take more than 2 % of a strain away; not in the field.
    """

    effects: tuple[str, ...]
    field_px: Array
    left_in: tuple[str, ...]


def moved_by(observation: Observation, known: Sequence[KnownEffect]) -> Moved:
    """What effects have moved, their amplitudes refitted together with drift, distortion and motion.

    Raises:
        BadInput: an effect is unknown, or cannot be in these data.
    """
    having, fields = joined(quiet(observation), known)
    amplitudes = amplitudes_of(having)
    total, first = np.zeros((observation.frames, observation.blocks, 2)), 0
    harmful = []
    for one, field, share in zip(known, fields, eaten(having, fields, len(fields)), strict=True):
        if family_of(one.name).strain or share > HARMLESS:
            harmful.append(one.name)
        else:
            total += field @ amplitudes[first : first + field.shape[-1]]
        first += field.shape[-1]
    return Moved(tuple(one.name for one in known), total - total[0], tuple(harmful))


def at_points(observation: Observation, moved: Array, grid: Grid) -> dict[int, Array]:
    """By the number of each frame (ny, nx, 2) what effects move at every point, from what they move in blocks (f, b, 2).

    The smoothest surface through the blocks: effects are smooth over a subset, as correlation shows nothing finer.
    """
    scene = observation.scene
    place = scene.address_px[0] + observation.state.centre_px
    points = np.stack(grid.mesh(), axis=-1).reshape(-1, 2)
    values = np.moveaxis(moved, 0, 1).reshape(len(place), -1)
    spread = RBFInterpolator(place, values, kernel="thin_plate_spline", degree=1)(points)
    fields = spread.reshape(*grid.shape, len(scene.frame), 2)
    return {int(frame): fields[:, :, at] for at, frame in enumerate(scene.frame)}


def less(disparity: DisparityMap, by_frame: Mapping[int, Array]) -> DisparityMap:
    """A map without what moved by the number of each frame, (ny, nx, 2) px; as it is where nothing did."""
    if not by_frame:
        return disparity
    by = by_frame[disparity.current] - by_frame[disparity.reference]
    u, v = (one.copy() for one in (disparity.u_px, disparity.v_px))
    u[disparity.valid] -= by[..., 0][disparity.valid]
    v[disparity.valid] -= by[..., 1][disparity.valid]
    return replace(disparity, u_px=u, v_px=v)
