"""The terminal of the operator: questions are shown at once, and each typed line answers the latest open question.

Stage, load frame and trigger share one terminal. One thread reads it, which starts with the first question or answer source. The
subscriber receives every message and may answer instead of the terminal; the answer source receives each line first.
"""

from __future__ import annotations

import itertools
import sys
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from semlive.inputs.printable import printable
from semlive.ports import OperatorPrompt, PromptEvent, ResponseType

AnswerCallback = Callable[[str], bool]
"""Receives a line; returns True if it is the answer, False if the question stays open."""


@dataclass(frozen=True, slots=True)
class _Question:
    number: int
    text: str
    callback: AnswerCallback
    response: ResponseType


class Console:
    """A shared terminal; a `semlive.ports.OperatorInterface`.

    Args:
        lines: returns the typed lines; called one time, in a separate thread.
        show: shows one line.
    """

    def __init__(self, lines: Callable[[], Iterable[str]], show: Callable[[str], object]) -> None:
        self._lines, self._show = lines, show
        self._lock = threading.Lock()
        self._numbers = itertools.count(1)
        self._open_questions: list[_Question] = []
        self._listening = False
        self._subscriber: Callable[[OperatorPrompt], object] | None = None
        self._answer_source: AnswerCallback | None = None

    def subscribe(self, callback: Callable[[OperatorPrompt], object]) -> None:
        """Send every message to `callback` from now on."""
        self._subscriber = callback

    def add_answer_source(self, callback: AnswerCallback) -> None:
        """Send every typed line to `callback` first, in another thread; a line for which it returns True answers no question."""
        self._answer_source = callback
        self._start_thread()

    def show(self, text: str) -> None:
        """Show a line."""
        self._show(text)
        self._publish(OperatorPrompt(PromptEvent.MESSAGE, text))

    def ask(self, text: str, callback: AnswerCallback, response: ResponseType = ResponseType.CONFIRMATION) -> None:
        """Show a question and send the typed lines to `callback`, in another thread, until it returns True."""
        self.withdraw(callback)
        question = _Question(next(self._numbers), text, callback, response)
        with self._lock:
            self._open_questions.append(question)
        # Published first: an answer to what is shown can come at once, and the log holds the question before it.
        self._publish(OperatorPrompt(PromptEvent.PROMPT, text, question.number, response))
        self._show(text)
        self._start_thread()

    def answer(self, question: int, line: str) -> bool:
        """Answer a question by its number, not from the terminal; False if it is not open any more."""
        with self._lock:
            open_question = next((candidate for candidate in self._open_questions if candidate.number == question), None)
        if open_question is not None:
            self._receive(open_question, line)
        return open_question is not None

    def withdraw(self, callback: AnswerCallback) -> None:
        """Withdraw the question with this callback."""
        with self._lock:
            withdrawn = [question for question in self._open_questions if question.callback == callback]
            self._open_questions = [question for question in self._open_questions if question.callback != callback]
        for question in withdrawn:
            self._publish(OperatorPrompt(PromptEvent.WITHDRAWN, question.text, question.number, question.response))

    def _start_thread(self) -> None:
        with self._lock:
            start, self._listening = not self._listening, True
        if start:
            threading.Thread(target=self._listen, name="console", daemon=True).start()

    def _listen(self) -> None:
        for line in self._lines():
            if self._answer_source is not None and self._answer_source(line):
                continue
            with self._lock:
                newest = self._open_questions[-1] if self._open_questions else None
            if newest is not None:
                self._receive(newest, line)
        with self._lock:
            self._listening = False

    def _receive(self, question: _Question, line: str) -> None:
        line = line.strip()
        if not question.callback(line):
            return
        with self._lock:
            was_open = question in self._open_questions
            self._open_questions = [other for other in self._open_questions if other is not question]
        if was_open:
            self._publish(OperatorPrompt(PromptEvent.RESPONSE, line, question.number, question.response))

    def _publish(self, prompt: OperatorPrompt) -> None:
        if self._subscriber is not None:
            self._subscriber(prompt)


def _show(line: str) -> None:
    sys.stdout.write(printable(line) + "\n")
    sys.stdout.flush()


TERMINAL = Console(lambda: iter(sys.stdin.readline, ""), _show)
"""The terminal of this process."""
