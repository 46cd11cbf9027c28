"""What drivers ask a person, written down, and answered from wherever the answer comes."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from functools import partial

from semlive.data.operator_prompts import OperatorPrompt
from semlive.formats.log.messages import OperatorMessage
from semlive.ports import ClockSource, OperatorInterface


class OperatorPrompts:
    """All desks of a run; a question's name is its desk and its number there, as in ``terminal.3``.

    Args:
        desks: by name.
        clock: experiment time.
        note: writes down; called in the thread in which a word is said.
    """

    def __init__(self, desks: Mapping[str, OperatorInterface], clock: ClockSource, note: Callable[[OperatorMessage], object]) -> None:
        self._desks, self._clock, self._note = desks, clock, note
        for name, desk in desks.items():
            desk.subscribe(partial(self._heard, name))

    def answer(self, question: str, line: str) -> bool:
        """Answer a question; False if it is not open. May block as long as a terminal does."""
        name, _, number = question.rpartition(".")
        desk = self._desks.get(name)
        return desk is not None and number.isdecimal() and desk.answer(int(number), line)

    def close(self) -> None:
        """Listen no more."""
        for desk in self._desks.values():
            desk.subscribe(lambda _: None)

    def _heard(self, name: str, word: OperatorPrompt) -> None:
        about = {} if word.question is None else {"question": f"{name}.{word.question}", "wanted": word.response_type.value}
        # The loop may be closed by now: then nobody has to know any more.
        with contextlib.suppress(RuntimeError):
            self._note(OperatorMessage(time_ns=self._clock.now_ns(), what=word.kind, args={"text": word.text, **about}))
