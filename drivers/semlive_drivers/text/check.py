"""Check of a device against its dialogue: identity and plausible values. It sends questions and no orders."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from semlive.data.checks import Finding, FrameCheck, Verdict
from semlive.errors import LinkError
from semlive.ports import ClockSource
from semlive_drivers.device_part import OrderBook
from semlive_drivers.text.part import TextPart, open_part


def check_text(
    name: str,
    settings: Mapping[str, object],
    clock: ClockSource,
    orders: Callable[[OrderBook], Iterable[Finding]] = lambda book: (),
) -> FrameCheck:
    """Ask the questions of every reading and compare the replies with the description.

    Args:
        name: name of the description, or a path.
        settings: as of the driver.
        clock: experiment time.
        orders: checks orders against those that the device can take.

    Raises:
        BadConfig: for settings or a description that are not valid.
        LinkRefused: if the line cannot be opened, or another device answers.
    """
    part = open_part({**settings, "map": name}, clock, "frame check")
    try:
        dialogue = part.dialogue
        findings = (
            []
            if dialogue.identity
            else [Finding("identity", "the description has none", Verdict.UNKNOWN, "make sure that the line is this machine's")]
        )
        findings += [Finding("identity", step.ask, Verdict.OK) for step in dialogue.identity]
        findings += [finding for ask in dialogue.every_turn for finding in _compare(part, ask)]
        try:
            part.identify()
        except LinkError as error:
            findings.append(Finding("reading", str(error), Verdict.FAILED, "every reading would be refused until that is corrected"))
        findings += orders(part.book)
    finally:
        part.close()
    return FrameCheck(dialogue.name, part.where, dialogue.source, dialogue.confirmed, tuple(findings))


def _compare(part: TextPart, ask: str) -> Iterator[Finding]:
    try:
        reply = part.session.ask(ask)
    except LinkError as error:
        yield Finding(ask, str(error), Verdict.FAILED, "check line, station and description")
        part.session.recover()
        return
    for group, value in reply.items():
        if not isinstance(value, float) or group not in part.dialogue.plausible:
            yield Finding(group, f"{value:g}" if isinstance(value, float) else str(value), Verdict.UNKNOWN)
            continue
        low, high = part.dialogue.plausible[group]
        passed = low <= value <= high
        advice = "" if passed else f"{low:g} to {high:g} is plausible at rest: check unit and description"
        yield Finding(group, f"{value:g}", Verdict.OK if passed else Verdict.FAILED, advice)
