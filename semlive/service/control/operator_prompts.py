"""Prompts of drivers to the operator: logging, and answers from any source."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from functools import partial

from semlive.data.operator_prompts import OperatorPrompt
from semlive.formats.log.messages import OperatorMessage
from semlive.ports import ClockSource, OperatorInterface


class OperatorPrompts:
    """All operator interfaces of a run. The name of a question is its interface and its number there, as in ``terminal.3``.

    Args:
        interfaces: operator interfaces by name.
        clock: experiment time.
        record: writes a message to the log; called in the thread of the prompt.
    """

    def __init__(
        self, interfaces: Mapping[str, OperatorInterface], clock: ClockSource, record: Callable[[OperatorMessage], object]
    ) -> None:
        self._interfaces, self._clock, self._record = interfaces, clock, record
        for name, interface in interfaces.items():
            interface.subscribe(partial(self._on_prompt, name))

    def answer(self, question: str, line: str) -> bool:
        """Answer a question; False if it is not open. May block as long as a terminal does."""
        name, _, number = question.rpartition(".")
        interface = self._interfaces.get(name)
        return interface is not None and number.isdecimal() and interface.answer(int(number), line)

    def close(self) -> None:
        """Unsubscribe from all interfaces."""
        for interface in self._interfaces.values():
            interface.subscribe(lambda _: None)

    def _on_prompt(self, name: str, prompt: OperatorPrompt) -> None:
        arguments = {} if prompt.question is None else {"question": f"{name}.{prompt.question}", "wanted": prompt.response_type.value}
        # The loop may be closed; the message is then not needed.
        with contextlib.suppress(RuntimeError):
            self._record(OperatorMessage(time_ns=self._clock.now_ns(), what=prompt.kind, args={"text": prompt.text, **arguments}))
