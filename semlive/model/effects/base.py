"""Base of the effect classes that are not observed in disparity maps: name, description and discriminating experiment."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """An effect of the dictionary.

    Attributes:
        name: canonical name.
        description: what happens, one sentence.
        discriminating_experiment: the experiment that separates it from confounded effects, one sentence.
        group: group of confounded effects, or None.
    """

    name: str
    description: str
    discriminating_experiment: str
    group: str | None = None
