"""Effects on the motion of specimen and stage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from semlive_simulators.effects.interfaces import (
    Array,
    ByMagnification,
    Effect,
    Instants,
    PixelVisits,
    Plane,
    step_function,
)
from semlive_simulators.kernels.pattern import gaussian


@dataclass(frozen=True, slots=True)
class CreepInHold(Effect):
    """The specimen creeps during a hold.

    eps(T) = c F ln(1 + (T - T_k) / t0) since the last load step, eyy = eps, exx = -nu eps.

    Attributes:
        strain_per_n: c.
        onset_s: t0.
        poissons_ratio: nu.
    """

    name: ClassVar[str] = "creep_in_hold"
    typical = (6e-8, 10.0, 0.33)
    """Near yield: 0.14 px at the edge 125 s after a step to 2200 N."""

    strain_per_n: float
    onset_s: float
    poissons_ratio: float

    def specimen_shift_px(self, at: Instants) -> Array:
        """Zero: the centre does not move."""
        return np.zeros((at.time_s.size, 2))

    def specimen_gradient(self, at: Instants) -> Array:
        """Uniaxial strain along y."""
        strain = np.zeros(at.time_s.size)
        for step in at.motion.history.load_steps:
            elapsed_s = np.maximum(at.time_s - step.time_s, 0.0)
            creep = self.strain_per_n * at.motion.load_at(at.time_s) * np.log1p(elapsed_s / self.onset_s)
            strain = np.where(at.time_s >= step.time_s, creep, strain)
        return strain[:, None, None] * np.array([[-self.poissons_ratio, 0.0], [0.0, 1.0]])


@dataclass(frozen=True, slots=True)
class LoadStepTransient(Effect):
    """Settling of grips and load frame after each load step: the field of view moves with a decaying rate.

    D += dF A exp(-(T - T_k) / tau) after every load step k.

    Attributes:
        x_px_per_n: A in x.
        y_px_per_n: A in y.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "load_step_transient"
    typical = (ByMagnification(0.001, 0.05), ByMagnification(0.003, 0.15), 60.0)
    """1 or 50 px after a step of 350 N."""

    x_px_per_n: float
    y_px_per_n: float
    time_constant_s: float

    def drift_px(self, at: Instants) -> Array:
        """An exponential decay after every load step."""
        total = np.zeros(at.time_s.size)
        for step in at.motion.history.load_steps:
            elapsed_s = np.maximum(at.time_s - step.time_s, 0.0)
            total += np.where(at.time_s >= step.time_s, step.change_n * np.exp(-elapsed_s / self.time_constant_s), 0.0)
        return total[:, None] * np.array([self.x_px_per_n, self.y_px_per_n])


@dataclass(frozen=True, slots=True)
class StageStepTransient(Effect):
    """Gears and piezos relax after each move of the stage.

    D += A m_n exp(-(T - T_n) / tau) after every move n by m_n.

    Attributes:
        fraction: A, fraction of a move that relaxes.
        time_constant_s: tau.
    """

    name: ClassVar[str] = "stage_step_transient"
    typical = (ByMagnification(0.02, 0.3), 60.0)
    """0.5 px after 25 px, or 3 px after 10 px."""

    fraction: float
    time_constant_s: float

    def drift_px(self, at: Instants) -> Array:
        """An exponential decay after every move."""
        total = np.zeros((at.time_s.size, 2))
        for move in at.motion.history.moves:
            elapsed_s = np.maximum(at.time_s - move.time_s, 0.0)
            remaining = np.where(at.time_s >= move.time_s, self.fraction * np.exp(-elapsed_s / self.time_constant_s), 0.0)
            total += remaining[:, None] * np.array(move.change_px)
        return total


@dataclass(frozen=True, slots=True)
class StageBacklash(Effect):
    """The end position of the stage depends on the direction of the move.

    m = c + b sign(dc) in each axis, dc the last move that was not zero.

    Attributes:
        backlash_um: b, half the total backlash.
    """

    name: ClassVar[str] = "stage_backlash"
    typical = (1.0,)
    """1 um: 0.8 or 40 px."""

    backlash_um: float

    def specimen_shift_px(self, at: Instants) -> Array:
        """An offset with the sign of the last motion."""
        sign = np.zeros((at.time_s.size, 2))
        for move in at.motion.history.moves:
            change = np.array(move.change_px)
            sign = np.where((at.time_s >= move.time_s)[:, None] & (change != 0), np.sign(change), sign)
        return sign * self.backlash_um / at.scan.pixel_size_um

    def specimen_gradient(self, at: Instants) -> Array:
        """Zero: the stage does not strain the specimen."""
        return np.zeros((at.time_s.size, 2, 2))


@dataclass(frozen=True, slots=True)
class StageQuadratic(Effect):
    """The position error of the stage grows with the square of its position.

    m = c + q c^2 in each axis, c the commanded position.

    Attributes:
        quadratic_per_um: q.
    """

    name: ClassVar[str] = "stage_quadratic"
    typical = (ByMagnification(4e-4, 0.3),)
    """0.5 px at 40 um, or 12 px at 1 um."""

    quadratic_per_um: float

    def specimen_shift_px(self, at: Instants) -> Array:
        """The error at the end of the last move."""
        position_px = np.zeros((at.time_s.size, 2))
        for move in at.motion.history.moves:
            position_px = np.where((at.time_s >= move.time_s)[:, None], np.array(move.to_px), position_px)
        return self.quadratic_per_um * at.scan.pixel_size_um * position_px**2

    def specimen_gradient(self, at: Instants) -> Array:
        """Zero: the stage does not strain the specimen."""
        return np.zeros((at.time_s.size, 2, 2))


@dataclass(frozen=True, slots=True)
class StageYaw(Effect):
    """The guides of the stage rotate the specimen slightly with each move.

    (u, v) = theta_n (-(y - yc), x - xc) after move n, theta_n normal.

    Attributes:
        sd_rad: standard deviation of theta_n.
        seed: seed of theta_n.
    """

    name: ClassVar[str] = "stage_yaw"
    typical = (3e-4,)
    """3e-4 rad, which is 0.15 px at the edge."""

    sd_rad: float
    seed: int = 1

    def specimen_shift_px(self, at: Instants) -> Array:
        """Zero: the centre does not move."""
        return np.zeros((at.time_s.size, 2))

    def specimen_gradient(self, at: Instants) -> Array:
        """A rotation."""
        theta = np.zeros(at.time_s.size)
        for number, move in enumerate(at.motion.history.moves):
            theta = np.where(at.time_s >= move.time_s, self.sd_rad * gaussian(self.seed, 30, number), theta)
        return theta[:, None, None] * np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class DriftJump(Effect):
    """A permanent jump within a frame, as by a slipping grip, an electrical breakdown or thermal stress.

    (u, v) = J H(T - T_s).

    Attributes:
        x_px: J in x.
        y_px: J in y.
        at_s: T_s, seconds since the run began.
    """

    name: ClassVar[str] = "drift_jump"
    typical = (ByMagnification(0.3, 3.0), ByMagnification(0.5, 5.0), 600.0)
    """0.5 or 5 px after ten minutes."""

    x_px: float
    y_px: float
    at_s: float

    def offset_px(self, at: PixelVisits) -> Plane:
        """A jump between two pixels."""
        step = step_function(at.time_s, self.at_s)
        return self.x_px * step, self.y_px * step


@dataclass(frozen=True, slots=True)
class JumpWithinPair(Effect):
    """A jump between two frames.

    (u, v) = J in a frame and all later ones.

    Attributes:
        x_px: J in x.
        y_px: J in y.
        first_frame: number of the first frame after the jump.
    """

    name: ClassVar[str] = "jump_within_pair"
    typical = (ByMagnification(0.3, 3.0), ByMagnification(0.5, 5.0), 5)
    """0.5 or 5 px before the sixth frame."""

    x_px: float
    y_px: float
    first_frame: int

    def offset_px(self, at: PixelVisits) -> Plane:
        """Equal at all pixels."""
        jumped = np.full((1, 1), 1.0 if at.frame >= self.first_frame else 0.0)
        return self.x_px * jumped, self.y_px * jumped
