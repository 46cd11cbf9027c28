"""Why a verdict is UNKNOWN: the criterion that failed, with what it found."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class MisfitCriterion(StrEnum):
    """Criterion by which something in the data is not explained."""

    RESIDUAL = "residual"
    """The named class or unnamed field is significant in the residual."""
    UNNAMED_FIELD = "unnamed_field"
    """An unnamed field is more likely than the effect of this name."""
    TIME_COURSE = "time_course"
    """An effect has another time course than its law."""
    WEAK_EFFECT = "weak_effect"
    """The effect of this name is not significant next to the others."""
    ADEQUACY = "adequacy"
    """The residual fails the test of adequacy over the domain of this name."""
    SPATIAL_LINES = "spatial_lines"
    """The residual contains waves over the field."""
    ROWS = "rows"
    """The row shifts contain something that no effect explains."""
    GREY_LEVELS = "grey_levels"
    """The grey levels contain something that no effect explains."""


_TEXTS = {
    MisfitCriterion.RESIDUAL: "{name} is significant in the residual of the maps, logarithm of its Bayes factor {value:.1f}",
    MisfitCriterion.UNNAMED_FIELD: "an unnamed field is more likely than {name}, log odds {value:.1f}",
    MisfitCriterion.TIME_COURSE: "the time course differs from the law of the effect, log odds {value:.1f}",
    MisfitCriterion.WEAK_EFFECT: "{name} is not significant next to the other effects, logarithm of its Bayes factor {value:.1f}",
    MisfitCriterion.ADEQUACY: "the residual of the maps is not noise, test over {name}, p = {value:.1g}",
    MisfitCriterion.SPATIAL_LINES: "the residual of the maps contains waves over the field, p = {value:.1g}",
    MisfitCriterion.ROWS: "the row shifts contain something that no effect explains",
    MisfitCriterion.GREY_LEVELS: "the grey levels contain something that no effect explains",
}


@dataclass(frozen=True, slots=True)
class MisfitReason:
    """A criterion that failed.

    Attributes:
        criterion: the criterion.
        name: class, effect or domain; empty if there is none.
        value: log Bayes factor, log odds or p-value, as the criterion states; 0 if there is none.
    """

    criterion: MisfitCriterion
    name: str = ""
    value: float = 0.0

    @property
    def text(self) -> str:
        """The reason as a clause."""
        return _TEXTS[self.criterion].format(name=self.name, value=self.value)
