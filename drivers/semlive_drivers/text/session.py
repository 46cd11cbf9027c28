"""Questions and steps of a dialogue with one device over its serial line."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Mapping, Sequence

from semlive.data.loading import MotionState
from semlive.errors import LinkError, LinkRefused
from semlive_drivers.text.codec import fill_template, parse_reply, resolutions, with_check, without_check
from semlive_drivers.text.dialogue import Step, TextProtocol
from semlive_drivers.text.line import TextLine

_POLL_S = 0.02
"""Time between two questions of a step that waits for an answer."""

Reply = dict[str, str | float]


class DialogueSession:
    """Asks the questions of a dialogue and performs the steps of its orders.

    Args:
        line: open.
        dialogue: the description.
        units: units by group that differ from the description.
        station: number of the device on the line.
    """

    def __init__(self, line: TextLine, dialogue: TextProtocol, units: Mapping[str, str], station: int) -> None:
        self._line, self.dialogue = line, dialogue
        self._units = {**dialogue.units, **units}
        self._patterns = {name: re.compile(query.reply) for name, query in dialogue.asks.items()}
        self.values: dict[str, float] = {"station": float(station)}
        self.resolutions: dict[str, float] = {}
        has_stations = any("{station" in query.send for query in dialogue.asks.values())
        self.where = f"{line.where} station {station}" if has_stations else line.where

    def ask(self, name: str) -> Reply:
        """The reply to a question of the dialogue, by group.

        Raises:
            LinkError: if no valid reply comes.
        """
        query, check = self.dialogue.asks[name], self.dialogue.check
        received = self._line.query(self._request(query.send), self.dialogue.ends.encode(), query.lines)
        lines = [without_check(line, check, self.where) for line in received]
        text = "\n".join(line.decode("ascii", errors="replace") for line in lines)
        if self.dialogue.refused and text == self.dialogue.refused:
            raise LinkError(f"{self.where} does not understand {query.send.strip()!r}; check the description and the device's settings")
        self.resolutions |= resolutions(self._patterns[name], text, self._units, self.where)
        return parse_reply(self._patterns[name], text, self._units, self.where)

    def perform(self, step: Step) -> None:
        """Send the text of a step, or ask its question until the reply is as expected.

        Raises:
            LinkError: if the reply is not as expected within the time of the step, or the line fails.
        """
        if step.send:
            self._line.write(self._request(step.send))
            return
        end_s = time.monotonic() + step.within_s
        while (mismatch := self._mismatch(step)) and time.monotonic() < end_s:
            time.sleep(_POLL_S)
        if mismatch:
            raise LinkError(f"{self.where} did not take the command: {mismatch}; check the device's limits and who else commands it")

    def send_blind(self, steps: Sequence[Step]) -> bool:
        """Send the texts of steps without waiting for an answer; never raises.

        Returns:
            Whether anything was sent.
        """
        sent = False
        for step in steps:
            if step.send:
                with contextlib.suppress(LinkError, LinkRefused):
                    self._line.write_without_reply(self._request(step.send))
                    sent = True
        return sent

    def motion(self, reply: Reply) -> MotionState | None:
        """The motion state in a reply; None if the reply has none.

        Raises:
            LinkError: if the dialogue does not list the state.
        """
        state = reply.get("motion")
        if state is None:
            return None
        try:
            return self.dialogue.motion[str(state)]
        except KeyError:
            raise LinkError(f"{self.where} reports motion {state!r}, which does not exist; check the description") from None

    def recover(self) -> None:
        """Wait until no late reply is possible any more; never raises."""
        with contextlib.suppress(LinkError):
            self._line.recover()

    def close(self) -> None:
        """Close the line."""
        self._line.close()

    def _request(self, template: str) -> bytes:
        text = template.rstrip("\r\n")
        line_end = template[len(text) :].encode("ascii")
        return with_check(fill_template(text, self.values, exact=False), self.dialogue.check) + line_end

    def _mismatch(self, step: Step) -> str:
        """How the reply to the question of a step differs from the expected reply; empty if it does not."""
        reply = self.ask(step.ask)
        for group, name in step.equals.items():
            value = number(reply, group)
            if value is None or abs(value - self.values[name]) > step.tolerance:
                return f"{group} is {value} instead of {self.values[name]:g}"
        motion = self.motion(reply)
        return f"motion is {motion} instead of {step.motion}" if step.motion is not None and motion is not step.motion else ""


def number(reply: Reply, group: str) -> float | None:
    """The number in a group of a reply; None if the group holds none."""
    value = reply.get(group)
    return value if isinstance(value, float) else None
