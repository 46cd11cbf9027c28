"""The operator's terminal: what is asked is shown at once, and each line that is typed goes to whoever asked last and is still waiting.

Stage, load frame and trigger may all ask on one terminal. One thread reads it, begun with the first question or overhearer. Whoever follows
hears every word, and may answer in the terminal's place; whoever overhears has the first look at each line.
"""

from __future__ import annotations

import itertools
import sys
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from semlive.data.operator_prompts import OperatorPrompt, PromptEvent, ResponseType
from semlive.data.text import printable

AnswerCallback = Callable[[str], bool]
"""Takes a line; True if that was the answer, False to go on waiting."""


@dataclass(frozen=True, slots=True)
class _Question:
    number: int
    text: str
    heard: AnswerCallback
    wanted: ResponseType


class Console:
    """A terminal, shared; a `semlive.ports.OperatorInterface`.

    Args:
        lines: what is typed, line by line; called once, in a thread of its own.
        show: shows one line.
    """

    def __init__(self, lines: Callable[[], Iterable[str]], show: Callable[[str], object]) -> None:
        self._lines, self._show = lines, show
        self._lock = threading.Lock()
        self._numbers = itertools.count(1)
        self._waiting: list[_Question] = []
        self._listening = False
        self._follower: Callable[[OperatorPrompt], object] | None = None
        self._overhearer: AnswerCallback | None = None

    def subscribe(self, heard: Callable[[OperatorPrompt], object]) -> None:
        """Tell `heard` every word from now on."""
        self._follower = heard

    def add_answer_source(self, heard: AnswerCallback) -> None:
        """Give every line that is typed from now on to `heard` first, in another thread; what it says True to answers no question."""
        self._overhearer = heard
        self._begin()

    def show(self, text: str) -> None:
        """Show a line."""
        self._show(text)
        self._say(OperatorPrompt(PromptEvent.MESSAGE, text))

    def ask(self, text: str, heard: AnswerCallback, wanted: ResponseType = ResponseType.CONFIRMATION) -> None:
        """Show a line and give what is typed from now on to `heard`, in another thread, until it says True."""
        self.withdraw(heard)
        question = _Question(next(self._numbers), text, heard, wanted)
        with self._lock:
            self._waiting.append(question)
        self._show(text)
        self._say(OperatorPrompt(PromptEvent.PROMPT, text, question.number, wanted))
        self._begin()

    def answer(self, question: int, line: str) -> bool:
        """Answer a question from elsewhere; False if it is not open any more."""
        with self._lock:
            found = next((one for one in self._waiting if one.number == question), None)
        if found is not None:
            self._take(found, line)
        return found is not None

    def withdraw(self, heard: AnswerCallback) -> None:
        """Take a question back."""
        with self._lock:
            taken_back = [one for one in self._waiting if one.heard == heard]
            self._waiting = [one for one in self._waiting if one.heard != heard]
        for one in taken_back:
            self._say(OperatorPrompt(PromptEvent.WITHDRAWN, one.text, one.number, one.wanted))

    def _begin(self) -> None:
        with self._lock:
            start, self._listening = not self._listening, True
        if start:
            threading.Thread(target=self._listen, name="console", daemon=True).start()

    def _listen(self) -> None:
        for line in self._lines():
            if self._overhearer is not None and self._overhearer(line):
                continue
            with self._lock:
                newest = self._waiting[-1] if self._waiting else None
            if newest is not None:
                self._take(newest, line)
        with self._lock:
            self._listening = False

    def _take(self, question: _Question, line: str) -> None:
        line = line.strip()
        if not question.heard(line):
            return
        with self._lock:
            was_open = question in self._waiting
            self._waiting = [one for one in self._waiting if one is not question]
        if was_open:
            self._say(OperatorPrompt(PromptEvent.RESPONSE, line, question.number, question.wanted))

    def _say(self, word: OperatorPrompt) -> None:
        if self._follower is not None:
            self._follower(word)


def _show(line: str) -> None:
    sys.stdout.write(printable(line) + "\n")
    sys.stdout.flush()


TERMINAL = Console(lambda: iter(sys.stdin.readline, ""), _show)
"""The one of this process."""
