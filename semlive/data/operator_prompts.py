"""What a person at the instrument is told and asked, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class PromptEvent(StrEnum):
    """What happened between semlive and the person."""

    MESSAGE = "told"
    PROMPT = "asked"
    RESPONSE = "answered"
    WITHDRAWN = "taken_back"


class ResponseType(StrEnum):
    """What answers a question."""

    CONFIRMATION = "confirmation"
    LOAD_N = "load_n"


@dataclass(frozen=True, slots=True)
class OperatorPrompt:
    """One word of the conversation.

    Attributes:
        kind: told, asked, answered or taken back.
        text: what was said, one line.
        question: number of the question that it is about; None for what is only told.
        response_type: what answers the question.
    """

    kind: PromptEvent
    text: str
    question: int | None = None
    response_type: ResponseType = ResponseType.CONFIRMATION
