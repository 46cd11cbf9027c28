"""Results of a check of a load frame or a computer; nothing is moved."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """Result of one check."""

    OK = "good"
    UNKNOWN = "open"
    FAILED = "bad"


@dataclass(frozen=True, slots=True)
class Finding:
    """One checked item.

    Attributes:
        what: checked item: a register, an identity, a word order.
        observation: value or message of the device.
        verdict: agreement with the description; ``UNKNOWN`` where the check is not possible now.
        advice: remedy; empty if none is needed.
    """

    what: str
    observation: str
    verdict: Verdict
    advice: str = ""

    def to_json(self) -> dict[str, str]:
        """The finding with the keys of `semlive doctor --json` and `semlive frame check --json`."""
        return {"what": self.what, "said": self.observation, "verdict": self.verdict.value, "advice": self.advice}


@dataclass(frozen=True, slots=True)
class FrameCheck:
    """Findings of one check.

    Attributes:
        device: name of the description.
        where: address under which the device was reached.
        source: origin of the description.
        confirmed: whether a person compared the description with the machine.
        findings: in the order of the checks.
        proved: whether the readings were compared with the device's panel, or the description is one of a make that comes with semlive;
            otherwise another description might explain the same answers.
    """

    device: str
    where: str
    source: str
    confirmed: bool
    findings: tuple[Finding, ...]
    proved: bool = True

    @property
    def passed(self) -> bool:
        """True if no check failed and the readings are proved."""
        return self.proved and all(finding.verdict is not Verdict.FAILED for finding in self.findings)
