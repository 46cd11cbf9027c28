"""Check of a device against its dialogue: identity and plausible values. It sends questions and no orders."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

from semlive.data.checks import Finding, FrameCheck, Verdict
from semlive.errors import LinkError
from semlive.ports import ClockSource
from semlive_drivers.device_part import OrderBook
from semlive_drivers.maps import is_of_a_machine
from semlive_drivers.panel_reading import PanelReading, panel_readings
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
        settings: as of the driver, with the readings of the device's panel under the keys of `panel_reading.OPTIONS`.
        clock: experiment time.
        orders: checks orders against those that the device can take.

    Raises:
        BadConfig: for settings or a description that are not valid.
        LinkRefused: if the line cannot be opened, or another device answers.
    """
    panel, driver_settings = panel_readings(settings)
    part = open_part({**driver_settings, "map": name}, clock, "frame check")
    try:
        dialogue = part.dialogue
        findings = (
            []
            if dialogue.identity
            else [Finding("identity", "the description has none", Verdict.UNKNOWN, "make sure that the line is this machine's")]
        )
        findings += [Finding("identity", step.ask, Verdict.OK) for step in dialogue.identity]
        values: dict[str, float] = {}
        findings += [finding for ask in dialogue.every_turn for finding in _compare(part, ask, values)]
        proofs = list(_proofs(values, panel))
        findings += proofs
        try:
            part.identify()
        except LinkError as error:
            findings.append(Finding("reading", str(error), Verdict.FAILED, "every reading would be refused until that is corrected"))
        findings += orders(part.book)
    finally:
        part.close()
    proved = is_of_a_machine(name) or all(finding.verdict is Verdict.OK for finding in proofs)
    return FrameCheck(dialogue.name, part.where, dialogue.source, dialogue.confirmed, tuple(findings), proved)


def _proofs(values: Mapping[str, float], panel: Mapping[str, PanelReading]) -> Iterator[Finding]:
    """Whether force and extension agree with the device's panel."""
    for group, unit in (("force", "N"), ("extension", "mm")):
        key, what = f"{group}_reads", f"scale of {group}"
        if group not in values:
            continue
        if key not in panel:
            advice = f"give what the device's panel shows, with all digits: --{group}-reads 123.456; or hang a known weight on the cell"
            yield Finding(what, "no reading at rest shows unit and sign", Verdict.UNKNOWN, advice)
            continue
        agrees = abs(values[group] - panel[key].value) <= panel[key].tolerance
        text = f"{values[group]:g} {unit}, and {panel[key].value:g} {unit} on the panel"
        if not agrees:
            yield Finding(
                what, text, Verdict.FAILED, "correct unit and sign in the description (units), or give only digits that stand still"
            )
        elif not panel[key].proves:
            yield Finding(what, text, Verdict.UNKNOWN, "too small to show unit and sign: press on the cell by hand, and check again")
        else:
            yield Finding(what, text, Verdict.OK)


def _compare(part: TextPart, ask: str, values: dict[str, float]) -> Iterator[Finding]:
    """Compare the reply to a question with the description; adds its numbers to `values`."""
    try:
        reply = part.session.ask(ask)
    except LinkError as error:
        yield Finding(ask, str(error), Verdict.FAILED, "check line, station and description")
        part.session.recover()
        return
    values |= {group: value for group, value in reply.items() if isinstance(value, float)}
    for group, value in reply.items():
        if not isinstance(value, float) or group not in part.dialogue.plausible:
            yield Finding(group, f"{value:g}" if isinstance(value, float) else str(value), Verdict.UNKNOWN)
            continue
        low, high = part.dialogue.plausible[group]
        passed = low <= value <= high
        advice = "" if passed else f"{low:g} to {high:g} is plausible at rest: check unit and description"
        yield Finding(group, f"{value:g}", Verdict.OK if passed else Verdict.FAILED, advice)
