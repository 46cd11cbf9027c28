"""Findings about the layout of a description: whether it, or another one, explains what the device answers. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from semlive.data.checks import Finding, Verdict
from semlive_drivers.modbus.checking.evidence import Samples, bits_of, first_values, value_of
from semlive_drivers.modbus.checking.explanations import Described, Explanation, as_described, distinct, explain
from semlive_drivers.modbus.checking.wording import correction, layout, order_name, values
from semlive_drivers.modbus.registers import RegisterPoint

ORDER = "order of words"
"""The finding of the layout, named after its most frequent error."""
_SHOWN = 5
_LEAST = 1e-6
"""A smaller float shows no order of registers."""
_OPTIONS = {"force": "--force-reads", "extension": "--extension-reads"}


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Findings of the layout.

    Attributes:
        findings: to be shown.
        proved: whether every measured number was compared with the device's panel, and only the description explains the answers.
        found: whether some layout explains the answers with numbers other than 0 and a known scale.
    """

    findings: tuple[Finding, ...]
    proved: bool
    found: bool = True


def diagnose(described: Described, samples: Samples, shipped: Mapping[str, RegisterPoint] | None = None) -> Diagnosis:
    """Compare a description with all others that may explain the device.

    Args:
        described: the description, with the known readings.
        samples: registers that were read, at least three times.
        shipped: points of the maker's documents, if the description is one of a make that comes with semlive; if they fit, they
            are right.
    """
    units = _units(described)
    explanations = list(distinct(described, explain(described, samples), samples))
    contradicted: list[Finding] = []
    if not explanations and any(measured.panel for measured in described.measured):
        contradicted = list(_unexplained(described, units))
        described = replace(described, measured=tuple(replace(measured, panel=None) for measured in described.measured))
        explanations = list(distinct(described, explain(described, samples), samples))
    if shipped is not None:
        explanations = [one for one in explanations if _is_of(one, shipped)] or explanations
    own = as_described(described, explanations)
    proofs = list(_proofs(described, units))
    verdict = _verdict(described, explanations, own, samples)
    listed = [] if verdict.verdict is Verdict.OK else list(_listed(described, explanations, units))
    findings = (verdict, *listed, *contradicted, *proofs)
    much = _says_much(explanations, samples)
    proved = bool(proofs) and much and all(finding.verdict is Verdict.OK for finding in findings)
    return Diagnosis(findings, proved, much and not contradicted)


def _is_of(explanation: Explanation, points: Mapping[str, RegisterPoint]) -> bool:
    """Whether every measured number is at a point, in any scale."""
    return all(replace(choice.point, scale=points[name].scale) == points[name] for name, choice in explanation.chosen.items())


def _says_much(explanations: Sequence[Explanation], samples: Samples) -> bool:
    """Whether the best explanation has a number that is not 0, and no open scale."""
    if not explanations:
        return False
    chosen = explanations[0].chosen.values()
    return any(any(first_values(choice.point, samples)) for choice in chosen) and not any(choice.scale_open for choice in chosen)


def _verdict(described: Described, explanations: Sequence[Explanation], own: Explanation | None, samples: Samples) -> Finding:
    names = ", ".join(measured.name for measured in described.measured)
    if not explanations:
        advice = "check address, kind, dtype and order of words with the manual; at rest and with power on the values must be plausible"
        return Finding(ORDER, f"{names}: no order makes sense", Verdict.FAILED, advice)
    if own is not None and not any(any(first_values(choice.point, samples)) for choice in own.chosen.values()):
        return _at_zero(described, samples)
    if len(explanations) > 1:
        texts = "; or ".join(layout(one, described.points) for one in explanations[:_SHOWN])
        more = f"; and {len(explanations) - _SHOWN} more" if len(explanations) > _SHOWN else ""
        return Finding(
            ORDER,
            f"{len(explanations)} explanations fit: {texts}{more}",
            Verdict.FAILED if own is None else Verdict.UNKNOWN,
            f"do not choose by this check alone: {_how_to_decide(described, explanations)}",
        )
    if own is not None:
        orders = dict.fromkeys(order_name(choice.point) or "one register" for choice in own.chosen.values())
        return Finding(ORDER, f"{names}: {' and '.join(orders)} makes sense", Verdict.OK)
    (only,) = explanations
    return Finding(ORDER, f"{layout(only, described.points)} makes sense", Verdict.FAILED, _advice(described, only))


def _at_zero(described: Described, samples: Samples) -> Finding:
    """The finding where force and extension are 0: another number with several registers may show the order."""
    for name in sorted(described.read_points()):
        point = described.points[name]
        if point.dtype.is_float and any(first_values(point, samples)):
            value = value_of(point, samples, described.points)
            if value is not None and bits_of(point, samples, value, abs(value)) is not None and abs(value) > _LEAST:
                return Finding(ORDER, f"{name}: {order_name(point)} makes sense", Verdict.OK)
    return Finding(ORDER, "every number with several registers is zero", Verdict.UNKNOWN, "load the cell a little and check again")


def _advice(described: Described, only: Explanation) -> str:
    points = {name: described.points[name] for name in only.chosen}
    same = all(
        replace(only.chosen[name].point, word_order=point.word_order, byte_order=point.byte_order) == point
        for name, point in points.items()
    )
    if same:
        states = ", ".join(dict.fromkeys(order_name(point) for point in points.values()))
    else:
        states = ", ".join(f"{name} as {point.dtype} in {point.kind.entry_name} {point.address}" for name, point in points.items())
    right = correction(only, described.points)
    return f"the description states {states}: correct it ({right}), and check again with a known reading (--force-reads)"


def _how_to_decide(described: Described, explanations: Sequence[Explanation]) -> str:
    panel = [measured for measured in described.measured if measured.panel is not None]
    ways = ["press on the cell by hand and check again: in the right explanation the value follows the hand, without jumps"]
    if not panel:
        ways.append(
            "hang a known weight on the cell, or give what the device's panel shows (--force-reads 123.456, --extension-reads 1.234)"
        )
    else:
        ways[0] = "press on the cell by hand, so that the panel shows no round number, and check again with this reading and all its digits"
        if _signs_differ(explanations):
            ways.append("check again with a load in the other direction, so that the panel shows a negative number")
    return "; or ".join(ways)


def _signs_differ(explanations: Sequence[Explanation]) -> bool:
    return len({tuple(choice.point.dtype.value for choice in one.chosen.values()) for one in explanations}) > 1


def _listed(described: Described, explanations: Sequence[Explanation], units: dict[str, str]) -> Iterator[Finding]:
    for number, explanation in enumerate(explanations[:_SHOWN], 1):
        text = f"{layout(explanation, described.points)}: {values(explanation, units)}"
        yield Finding(f"explanation {number}", text, Verdict.UNKNOWN, correction(explanation, described.points) or "as described")


def _proofs(described: Described, units: dict[str, str]) -> Iterator[Finding]:
    """Whether each measured number is compared with a reading of the panel."""
    for measured in described.measured:
        what, option = f"scale of {measured.name}", option_of(described, measured.name)
        if option is None:
            continue
        if measured.panel is None:
            weight = "; or hang a known weight on the cell" if measured.name == described.device.tells.force else ""
            advice = f"give what the device's panel shows, with all digits: {option} 123.456{weight}"
            yield Finding(what, "no reading at rest shows scale and sign", Verdict.UNKNOWN, advice)
        elif not measured.panel.proves:
            observation = f"{measured.panel.value:g} {units[measured.name]} is too small to show the scale"
            larger = "press on the cell by hand" if measured.name == described.device.tells.force else "move the machine by its own panel"
            yield Finding(what, observation, Verdict.UNKNOWN, f"{larger}, and give the reading with all its digits")
        else:
            yield Finding(what, f"agrees with {measured.panel.value:g} {units[measured.name]} of the panel", Verdict.OK)


def _unexplained(described: Described, units: dict[str, str]) -> Iterator[Finding]:
    texts = [f"{m.name} {m.panel.value:g} {units[m.name]}" for m in described.measured if m.panel is not None]
    yield Finding(
        "known reading",
        f"{' with '.join(texts)}: no address, number format or scale near the description gives this",
        Verdict.FAILED,
        "check that the panel shows the same quantity at the same time (gross or net, tare, unit), then address and unit number",
    )


def option_of(described: Described, name: str) -> str | None:
    """The option that gives the known reading of a point."""
    tells = described.device.tells
    return _OPTIONS.get({tells.force: "force", tells.extension: "extension"}.get(name, ""))


def _units(described: Described) -> dict[str, str]:
    tells = described.device.tells
    pairs = ((tells.force, tells.force_unit), (tells.extension, tells.extension_unit), (tells.strain_gage, tells.strain_gage_unit))
    return {name: unit for name, unit in pairs if name is not None}
