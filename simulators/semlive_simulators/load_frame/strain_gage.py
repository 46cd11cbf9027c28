"""A strain gage on the back of the specimen: a second opinion on the strain, with errors of its own."""

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
        length_mm: of the grid; the strain is the mean over it.
        gain: said strain per true strain.
        offset: what it says of the unloaded specimen.
        noise: standard deviation of one reading.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    length_mm: float = 6.35
    gain: float = 1.005
    offset: float = 4.0e-6
    noise: float = 1.5e-6

    def reading(self, specimen: Specimen, force_n: float, seed: int, number: int, more: float = 0.0) -> float:
        """What it says under a force; `more` is what its grid sees besides the elastic strain of the plain sheet."""
        true = float(specimen.gradient(force_n)[1, 1]) + more
        return self.gain * true + self.offset + self.noise * gaussian(seed, _STREAM, number)
