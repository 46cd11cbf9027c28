"""What a person at the instrument is told and asked, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Asking(StrEnum):
    """What happened between semlive and the person."""

    TOLD = "told"
    ASKED = "asked"
    ANSWERED = "answered"
    TAKEN_BACK = "taken_back"


class Wanted(StrEnum):
    """What answers a question."""

    CONFIRMATION = "confirmation"
    LOAD_N = "load_n"


@dataclass(frozen=True, slots=True)
class Word:
    """One word of the conversation.

    Attributes:
        kind: told, asked, answered or taken back.
        text: what was said, one line.
        question: number of the question that it is about; None for what is only told.
        wanted: what answers the question.
    """

    kind: Asking
    text: str
    question: int | None = None
    wanted: Wanted = Wanted.CONFIRMATION
