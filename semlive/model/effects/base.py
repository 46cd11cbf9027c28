"""What every nameable effect beside the maps has: a name, what happens, and what decides."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """An effect with a name.

    Attributes:
        name: canonical.
        description: what happens, one sentence.
        discriminating_experiment: the experiment that tells it from its like, one sentence.
        group: of effects that it is confounded with, or None.
    """

    name: str
    description: str
    discriminating_experiment: str
    group: str | None = None
