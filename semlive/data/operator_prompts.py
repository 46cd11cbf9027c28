"""Messages and prompts to the operator of the instrument, and the responses."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class PromptEvent(StrEnum):
    """Event of the dialogue with the operator."""

    MESSAGE = "told"
    PROMPT = "asked"
    RESPONSE = "answered"
    WITHDRAWN = "taken_back"


class ResponseType(StrEnum):
    """Form of the response to a prompt."""

    CONFIRMATION = "confirmation"
    LOAD_N = "load_n"


@dataclass(frozen=True, slots=True)
class OperatorPrompt:
    """One event of the dialogue with the operator.

    Attributes:
        kind: message, prompt, response or withdrawal.
        text: content, one line.
        question: number of the prompt; None for messages.
        response_type: form of the response.
    """

    kind: PromptEvent
    text: str
    question: int | None = None
    response_type: ResponseType = ResponseType.CONFIRMATION
