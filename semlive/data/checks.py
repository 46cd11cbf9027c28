"""What a look at a load frame found, before anything is moved."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """What a finding means."""

    OK = "good"
    UNKNOWN = "open"
    FAILED = "bad"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        what: a register, an identity, an order of words.
        said: what the device says of it.
        verdict: whether it is as the description says; open, where that cannot be told now.
        advice: what to do, or nothing.
    """

    what: str
    said: str
    verdict: Verdict
    advice: str = ""


@dataclass(frozen=True, slots=True)
class FrameCheck:
    """Everything that was found.

    Attributes:
        device: name of the description.
        where: how it was reached.
        source: where the description is from.
        confirmed: somebody held it beside the machine.
        findings: in the order in which they were made.
    """

    device: str
    where: str
    source: str
    confirmed: bool
    findings: tuple[Finding, ...]

    @property
    def passed(self) -> bool:
        """Nothing is bad."""
        return all(finding.verdict is not Verdict.FAILED for finding in self.findings)
