"""Protocols of effects; an effect implements each protocol through which it acts on the image or on a sensor.

Signs: a positive offset moves the image to the right and down. With scan address R, distortion E, offsets b, deflection g, drift d and
centre c, the beam is at p = c + T (1 - g)(R - E - b - c) - d, where T is the scan rotation; the material point xi at this position
fulfils p = xi + s + G (xi - c) + w(xi). Slow quantities (g, d, s, G) are evaluated at the start and end of each row and interpolated
linearly; b and w are evaluated at every pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple, Protocol, Self, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict

from semlive_simulators.microscope.patterns import Pattern
from semlive_simulators.microscope.scan import Scan, Timing
from semlive_simulators.specimen.specimen import Motion

Array: TypeAlias = NDArray[np.float64]
Plane: TypeAlias = tuple[Array, Array]
"""x and y components, each of a shape that broadcasts to (rows, width)."""
Magnification: TypeAlias = Literal["x200", "x10000"]


class ByMagnification(NamedTuple):
    """A value at x200 and at x10000."""

    x200: float
    x10000: float


class Effect:
    """Base class of all effects. Each is a frozen dataclass whose fields have physical units.

    Attributes:
        name: name in reports and scenarios.
        apparent: whether its displacement of material points distorts the image and not the specimen.
        typical: typical values of the first fields; `ByMagnification` where they differ at x200 and x10000.
    """

    __slots__ = ()
    __pydantic_config__ = ConfigDict(extra="forbid")
    name: ClassVar[str]
    apparent: ClassVar[bool] = False
    typical: ClassVar[tuple[object, ...]]

    @classmethod
    def defaults(cls, magnification: Magnification) -> Self:
        """An effect of typical magnitude at x200 or x10000.

        Raises:
            ValueError: for any other magnification.
        """
        if magnification not in ("x200", "x10000"):
            raise ValueError(f"defaults are for x200 or x10000, not {magnification}")
        make: Callable[..., Self] = cls
        return make(*(getattr(value, magnification) if isinstance(value, ByMagnification) else value for value in cls.typical))


@dataclass(frozen=True, slots=True, eq=False)
class Instants:
    """Instants of a frame.

    Attributes:
        time_s: (n,) seconds since the run began.
        start_s: start of the frame, seconds since the run began.
        frame: number of the frame.
        scan: the raster.
        motion: motion, load and history of the specimen.
    """

    time_s: Array
    start_s: float
    frame: int
    scan: Scan
    motion: Motion


@dataclass(frozen=True, slots=True, eq=False)
class PixelVisits:
    """Visits of the pixels of rows.

    Attributes:
        x_px: (1, width) columns.
        y_px: (rows, 1) rows.
        time_s: (rows, width) seconds since the run began.
        start_s: when the frame began.
        frame: its number.
        visit: number of the visit within the frame.
        reversed_rows: (rows, 1) whether a row is scanned from right to left.
        scan: the raster.
        motion: of the specimen, its load and what was done to it.
        distortion_px: E at these addresses.
    """

    x_px: Array
    y_px: Array
    time_s: Array
    start_s: float
    frame: int
    visit: int
    reversed_rows: NDArray[np.bool_]
    scan: Scan
    motion: Motion
    distortion_px: Plane

    @property
    def in_frame_s(self) -> Array:
        """(rows, width) seconds since the frame began."""
        return self.time_s - self.start_s

    @property
    def from_centre_px(self) -> Plane:
        """Columns (1, width) and rows (rows, 1), from the centre of the frame."""
        centre = self.scan.centre_px
        return self.x_px - centre[0], self.y_px - centre[1]

    @property
    def load_n(self) -> Array:
        """(rows, 1) true load at the start of each row, N."""
        return self.motion.load_at(self.time_s[:, :1])


def exponential_approach(time_s: Array, change: float, time_constant_s: float) -> Array:
    """An exponential approach to `change` from zero at the start of the run."""
    return -change * np.expm1(-time_s / time_constant_s)


def step_function(time_s: Array, instant_s: float) -> Array:
    """1 at and after an instant, 0 before."""
    return np.where(time_s >= instant_s, 1.0, 0.0)


def isotropic(strength: ArrayLike) -> Array:
    """(n, 2, 2) isotropic deflection of (n,) strengths."""
    return np.asarray(strength, dtype=np.float64)[:, None, None] * np.eye(2)


@runtime_checkable
class TimingEffect(Protocol):
    """Changes the times at which pixels are visited."""

    def retime(self, timing: Timing, scan: Scan) -> Timing:
        """The true timing."""
        ...


@runtime_checkable
class ScanEffect(Protocol):
    """Stretches, rotates or shears the raster."""

    def deflection(self, at: Instants) -> Array:
        """g, (n, 2, 2): the image moves by g (R - E - b - c)."""
        ...


@runtime_checkable
class DriftEffect(Protocol):
    """Moves the complete image slowly."""

    def drift_px(self, at: Instants) -> Array:
        """d, (n, 2)."""
        ...


@runtime_checkable
class PixelOffsetEffect(Protocol):
    """Moves the image at each pixel."""

    def offset_px(self, at: PixelVisits) -> Plane:
        """The offset b at every scan address."""
        ...


@runtime_checkable
class SpecimenMotionEffect(Protocol):
    """Moves the complete specimen, or strains it uniformly."""

    def specimen_shift_px(self, at: Instants) -> Array:
        """s, (n, 2)."""
        ...

    def specimen_gradient(self, at: Instants) -> Array:
        """G, (n, 2, 2)."""
        ...


@runtime_checkable
class DeformationEffect(Protocol):
    """Deforms the specimen, or depends on its material points."""

    def material_px(self, x_px: Array, y_px: Array, at: PixelVisits) -> Plane:
        """The deformation w at material points (rows, width)."""
        ...


@runtime_checkable
class HoleEffect(Protocol):
    """Removes material."""

    def absent(self, x_px: Array, y_px: Array, at: PixelVisits) -> NDArray[np.bool_]:
        """Whether material points (rows, width) do not exist."""
        ...


@runtime_checkable
class ProbeEffect(Protocol):
    """Widens the probe."""

    def blur_px2(self, at: Instants) -> Array:
        """(n, 2, 2) covariance, added to that of the spot."""
        ...


@runtime_checkable
class SpeckleEffect(Protocol):
    """Changes the speckle pattern."""

    def changed(self, speckle: Pattern) -> Pattern:
        """The changed pattern."""
        ...


@runtime_checkable
class IntensityEffect(Protocol):
    """Changes the signal before noise is added."""

    def grey(self, grey: Array, x_px: Array, y_px: Array, at: PixelVisits) -> Array:
        """The changed grey levels (rows, width) at material points (x, y)."""
        ...


@runtime_checkable
class NoiseEffect(Protocol):
    """Changes the variance of the noise."""

    def variance(self, variance: Array, grey: Array) -> Array:
        """The changed variance (rows, width), levels squared, at grey levels."""
        ...


@runtime_checkable
class PlasticityEffect(Protocol):
    """Elongates the specimen permanently."""

    def plastic_strain(self, peak_n: Array) -> Array:
        """(n,) plastic strain along y after highest loads (n,) so far, N; must not decrease."""
        ...


@runtime_checkable
class LoadCellEffect(Protocol):
    """Changes the reading of the load cell."""

    def load_reading_n(self, reading_n: float, time_s: float, motion: Motion) -> float:
        """The changed reading, N."""
        ...


@runtime_checkable
class ExtensometerEffect(Protocol):
    """Changes the reading of the extension."""

    def extension_reading_mm(self, reading_mm: float, load_n: float) -> float:
        """The changed reading at a true load, mm."""
        ...


@runtime_checkable
class TimestampEffect(Protocol):
    """Changes the times in the files."""

    def stamp_s(self, true_s: float) -> float:
        """Time on the clock of the microscope at a true time, both in seconds since the run began."""
        ...
