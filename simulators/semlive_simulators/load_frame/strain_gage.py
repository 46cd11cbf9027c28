"""A strain gage on the back of the specimen: an independent measurement of the strain, with its own errors."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import ConfigDict

from semlive_simulators.kernels.pattern import gaussian
from semlive_simulators.specimen.specimen import Specimen

_STREAM = 5


@dataclass(frozen=True, slots=True)
class StrainGage:
    """A gage along the loading direction.

    Attributes:
        length_mm: length of the grid, mm; the reading is the mean strain over it.
        gain: reading per true strain.
        offset: reading of the unloaded specimen.
        noise: standard deviation of one reading.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    length_mm: float = 6.35
    gain: float = 1.005
    offset: float = 4.0e-6
    noise: float = 1.5e-6

    def reading(self, specimen: Specimen, force_n: float, seed: int, number: int, further: float = 0.0) -> float:
        """The reading at a force, N; `further` is the strain of its grid in addition to the elastic strain of the plain sheet."""
        true = float(specimen.gradient(force_n)[1, 1]) + further
        return self.gain * true + self.offset + self.noise * gaussian(seed, _STREAM, number)
