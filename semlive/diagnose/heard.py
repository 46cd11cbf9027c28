"""A run before anything in it is named: its baseline, and every family heard beside that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis import KnownEffect
from semlive.diagnose.baseline import Ladder
from semlive.diagnose.evidence import Weighed, kept_for, weigh
from semlive.diagnose.known import joined
from semlive.diagnose.named import with_values_between
from semlive.diagnose.noise import quiet
from semlive.diagnose.observation import Observation
from semlive.diagnose.prepared import Prepared
from semlive.model.effects import Family


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """Families beside a baseline that has nothing but what was known.

    Attributes:
        bare: that baseline.
        already: (f, b, 2, q) what unit amplitudes of each known effect move, px.
        kept: the families' laws, ready to be asked again.
        families: what each says; those that cannot be seen here are left out.
    """

    bare: Ladder
    already: tuple[NDArray[np.float64], ...]
    kept: Mapping[str, Prepared]
    families: tuple[Weighed, ...]

    @classmethod
    def of(cls, observation: Observation, families: Sequence[Family], known: Sequence[KnownEffect]) -> Heard:
        """Hear them.

        Raises:
            BadInput: a known effect has no such name, or cannot be in these data.
        """
        bare, already = joined(quiet(observation), known)
        kept = kept_for(bare, families)
        return cls(bare, already, kept, with_values_between(bare, weigh(bare, families, kept)))

    @property
    def loudest(self) -> float:
        """Logarithm of the likelihood of the data beside the family that does most for it."""
        return self.bare.likelihood + max((one.log_factor for one in self.families), default=0.0)
