"""The true deformation of a frame at points, for specimens with non-uniform deformation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.interfaces import Array, Instants, PixelVisits, Plane
from semlive_simulators.microscope.scan import Scan
from semlive_simulators.specimen.specimen import Motion

_HALF_STEP_PX = 0.01
"""Half step of finite differences: truncation is 1e-8 of the strain for fields that vary over tens of px, rounding 1e-11."""


@dataclass(frozen=True, slots=True, eq=False)
class StrainField:
    """Displacement and small strain at existing material points.

    Attributes:
        x_px: (n,) material points, px of the frame.
        y_px: likewise.
        u_px: (n,) displacement to the right, without drift and distortion.
        v_px: (n,) displacement downwards.
        exx: (n,) strain.
        eyy: likewise.
        exy: likewise.
    """

    x_px: Array
    y_px: Array
    u_px: Array
    v_px: Array
    exx: Array
    eyy: Array
    exy: Array


def without_optical_effects(effects: EffectSet) -> EffectSet:
    """The effects without those that distort the image at charged points but do not strain the specimen."""
    return EffectSet(tuple(member for member in effects.members if not member.apparent))


def elongation(effects: EffectSet, scan: Scan, motion: Motion, time_s: float, length_px: float) -> float:
    """Mean additional strain along y by deforming effects, over a line along y through the centre of the frame."""
    deforming = without_optical_effects(effects)
    if not deforming.deforming:
        return 0.0
    centre = scan.centre_px
    x_px, y_px = np.full((2, 1), centre[0]), centre[1] + 0.5 * length_px * np.array([[-1.0], [1.0]])
    planes = deforming.material_px(x_px, y_px, _visits(scan, motion, x_px, y_px, time_s, time_s))
    v_px = np.sum([np.broadcast_to(plane[1], (2, 1)) for plane in planes], axis=0)
    return float(v_px[1, 0] - v_px[0, 0]) / length_px


def strain_field(effects: EffectSet, scan: Scan, motion: Motion, time_s: float, start_s: float, every_px: float) -> StrainField:
    """The true field at an instant.

    Args:
        effects: effects; apparent ones are ignored.
        scan: the raster; points include the edges of the frame.
        motion: motion of the specimen.
        time_s: the instant, seconds since the run began.
        start_s: start of the frame, seconds since the run began.
        every_px: approximate distance of the points, px.
    """
    across = np.linspace(0.0, scan.width_px - 1.0, max(2, round(scan.width_px / every_px) + 1))
    down = np.linspace(0.0, scan.height_px - 1.0, max(2, round(scan.height_px / every_px) + 1))
    x_px, y_px = np.meshgrid(across, down)
    at = _visits(scan, motion, x_px, y_px, time_s, start_s)
    state = effects.moved(Instants(np.array([time_s]), start_s, 0, scan, motion))
    gradient, shift = state.gradient[0], state.shift_px[0]
    centre, deforming = scan.centre_px, without_optical_effects(effects)

    def additional(dx_px: float, dy_px: float) -> Plane:
        planes = deforming.material_px(x_px + dx_px, y_px + dy_px, at)
        return sum((plane[0] for plane in planes), np.zeros(x_px.shape)), sum((plane[1] for plane in planes), np.zeros(x_px.shape))

    (u_px, v_px), step = additional(0.0, 0.0), _HALF_STEP_PX
    ux, vx = _difference(additional(step, 0.0), additional(-step, 0.0), step)
    uy, vy = _difference(additional(0.0, step), additional(0.0, -step), step)
    u_px = u_px + shift[0] + gradient[0, 0] * (x_px - centre[0]) + gradient[0, 1] * (y_px - centre[1])
    v_px = v_px + shift[1] + gradient[1, 0] * (x_px - centre[0]) + gradient[1, 1] * (y_px - centre[1])
    exy = 0.5 * (gradient[0, 1] + uy + gradient[1, 0] + vx)
    exists = ~effects.absent(x_px, y_px, at)
    planes = (x_px, y_px, u_px, v_px, gradient[0, 0] + ux, gradient[1, 1] + vy, exy)
    return StrainField(*(plane[exists] for plane in planes))


def _difference(ahead: Plane, behind: Plane, half_step_px: float) -> Plane:
    return (ahead[0] - behind[0]) / (2.0 * half_step_px), (ahead[1] - behind[1]) / (2.0 * half_step_px)


def _visits(scan: Scan, motion: Motion, x_px: Array, y_px: Array, time_s: float, start_s: float) -> PixelVisits:
    """All points at one instant."""
    forward: NDArray[np.bool_] = np.zeros((x_px.shape[0], 1), dtype=bool)
    zero = np.zeros(x_px.shape)
    return PixelVisits(x_px[:1], y_px[:, :1], np.full(x_px.shape, time_s), start_s, 0, 0, forward, scan, motion, (zero, zero))
