"""Sections of a configuration file as pydantic models."""

from __future__ import annotations

import dataclasses
import difflib
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from semlive.data.settings import RowClockUse, ScanProfile, ScanSpeed
from semlive.formats import SIDECAR_VENDORS


class AlertEvent(StrEnum):
    """Event of a run that persons who are not at the instrument can be alerted of; a value of the configuration key `alerts.events`."""

    FAULT = "fault"
    QUESTION = "question"
    WARM_UP = "warm_up"
    END = "end"


def reject_unknown_keys(cls: type, given: object) -> object:
    """Reject keys that a dataclass does not have; pydantic ignores them in a standard dataclass."""
    if isinstance(given, dict):
        names = [field.name for field in dataclasses.fields(cls)]
        for key in given:
            if key not in names:
                raise PydanticCustomError("unknown_key", "{hint}", {"key": str(key), "hint": _hint(str(key), names)})
    return given


def _hint(key: str, names: list[str]) -> str:
    close = difflib.get_close_matches(key, names, n=1)
    return f"did you mean {close[0]}?" if close else f"known keys are {', '.join(names)}"


class Section(BaseModel):
    """Section of a configuration: immutable, and without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _no_unreject_unknown_keys(cls, given: Any) -> Any:
        if isinstance(given, dict):
            names = list(cls.model_fields)
            for key in given:
                if key not in names:
                    raise PydanticCustomError("unknown_key", "{hint}", {"key": str(key), "hint": _hint(str(key), names)})
        return given


class RunSection(Section):
    """Name of the run, and the folder of its log."""

    name: str = Field(default="run", pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    folder: Path = Path("runs")
    """Folder in which the log is written, relative to the configuration file."""
    clock_file: Path | None = None
    """Clock file of a simulator; without it experiment time is the UTC of this computer."""
    segment_gb: float = Field(default=2.0, gt=0)
    """Size of a segment of the log in 10^9 bytes; above it, the next segment is started."""


class DriverSection(Section):
    """A device and its driver."""

    driver: str
    settings: dict[str, Any] = {}
    poll_s: float = Field(default=0.05, gt=0, le=10)
    """Time between two readings, s of wall time."""


class SemSection(Section):
    """Export folder of the SEM, and values that its files lack."""

    folder: Path
    pixel_size_um: float = Field(gt=0)
    """Converts shifts in px into stage motion; the analysis uses the pixel size of the file if there is one."""
    poll_s: float = Field(default=1.0, gt=0)
    """Interval at which the folder is scanned if no file-system event arrives, s of wall time."""
    file_events: bool = True
    """File-system events wake the scan of the folder; network shares send none."""
    stable_for_s: float = Field(default=2.0, gt=0)
    """Time without change after which a file counts as complete whose bytes do not prove it, s of wall time."""
    vendor: Literal["fei", "zeiss", "tescan", "jeol", "hitachi"] | None = None
    """Vendor of the files: a file counts as complete only with the header of this vendor, or with its text file (JEOL, Hitachi)."""
    row_clock: RowClockUse = "if_present"
    """Text file with the row starts of the instrument's own clock: `if_present` uses one that came before its image, `awaited` waits for it and else uses the image with equations 1 to 4, `required` waits and else rejects the image."""  # noqa: E501
    sidecar_timeout_s: float = Field(default=60.0, gt=0)
    """Time for which the text file of the vendor, or the row clock, is awaited, s of wall time."""
    probe_share: bool = False
    """Measure the clock of the computer of the folder at the start of the run, by writing a small file there."""
    trigger: DriverSection | None = None
    profile: Annotated[ScanProfile, BeforeValidator(lambda v: reject_unknown_keys(ScanProfile, v))] = ScanProfile()
    scan_profiles: list[Annotated[ScanSpeed, BeforeValidator(lambda v: reject_unknown_keys(ScanSpeed, v))]] = []
    """Scan times for each scan speed of the vendor, for files without times."""

    @model_validator(mode="after")
    def _row_clock_has_its_own_text(self) -> SemSection:
        if self.row_clock != "if_present" and self.vendor in SIDECAR_VENDORS:
            raise PydanticCustomError(
                "row_clock", f"row_clock must be if_present, because the text file of an image is that of {self.vendor}"
            )
        return self

    @property
    def scan_profile(self) -> ScanProfile:
        """Scan profile with the scan times of all speeds."""
        return dataclasses.replace(self.profile, speeds=(*self.profile.speeds, *self.scan_profiles))


class AlertsSection(Section):
    """Alerts to persons who are not at the instrument."""

    file: Path
    """File with one address on each line, as Apprise writes them: `json://host/path`, `mailto://user:password@host`; relative to the configuration file. The addresses are not logged."""  # noqa: E501
    events: tuple[AlertEvent, ...] = Field(default=tuple(AlertEvent), min_length=1)
    """Events that are reported: a fault that stops the run or needs a person, a question, the end of the warm-up, the end of the run."""


class WarmUpSection(Section):
    """Warm-up gate: maximum drift rate, or maximum change of it, before the first load."""

    max_rate_px_s: float | None = Field(default=None, gt=0)
    """Maximum of forecast drift rate plus standard uncertainty, px/s; until then, additional pairs are taken."""
    max_change_px_s: float | None = Field(default=None, gt=0)
    """Maximum change of the forecast drift rate from pair to pair plus standard uncertainty, px/s: the drift has settled. Needed if there is no `max_rate_px_s`."""  # noqa: E501
    max_wait_s: float = Field(default=1800.0, gt=0)
    """Waiting time after which the operator decides, s."""
    after_wait: Literal["ask", "continue"] = "ask"
    """After `max_wait_s`: the operator decides, or the run continues (only with `before: calibration`)."""
    before: Literal["calibration", "tension"] = "tension"
    """Phase that the gate precedes; `calibration`: the gate is after the first pair."""

    @model_validator(mode="after")
    def _has_maximum(self) -> WarmUpSection:
        if self.max_rate_px_s is None and self.max_change_px_s is None:
            raise PydanticCustomError("no_rate", "warm_up needs max_rate_px_s or max_change_px_s")
        if self.after_wait == "continue" and self.before == "tension":
            raise PydanticCustomError("no_decision", "after_wait: continue needs before: calibration; the operator decides about a load")
        return self


class AdaptiveHoldSection(Section):
    """Conditions that extend a hold beyond `hold_s`."""

    max_hold_s: float = Field(gt=0)
    max_rate_px_s: float | None = Field(default=None, gt=0)
    """Maximum drift rate, px/s: between the frames of the hold if there are any, otherwise the forecast."""
    max_relaxation_n_s: float | None = Field(default=None, gt=0)
    """Maximum rate of change of the load, N/s."""


class ProtocolSection(Section):
    """Steps of the experiment, and the conditions for a pair."""

    calibration_shifts_px: list[tuple[float, float]] = []
    translation_shifts_px: list[tuple[float, float]] = []
    loads_n: list[float] = []
    ramp_rate_n_s: float = Field(default=20.0, gt=0)
    hold_s: float = Field(default=30.0, ge=0)
    settle_s: float = Field(default=5.0, gt=0)
    load_tolerance_n: float = Field(default=10.0, gt=0)
    load_tolerance_fraction: float = Field(default=0.01, ge=0, lt=1)
    stage_tolerance_um: float = Field(default=5.0, gt=0)
    motion_timeout_s: float = Field(default=900.0, gt=0)
    recentre_beyond_px: float | None = Field(default=None, ge=0)
    """Before each step, the stage compensates a drift of the field of view of more than this, px; leave out for no recentring."""
    frame_timeout_s: float = Field(default=900.0, gt=0)
    warm_up: WarmUpSection | None = None
    adaptive_hold: AdaptiveHoldSection | None = None

    @model_validator(mode="after")
    def _has_steps(self) -> ProtocolSection:
        if not (self.calibration_shifts_px or self.translation_shifts_px or self.loads_n):
            raise PydanticCustomError("no_steps", "no calibration_shifts_px, translation_shifts_px or loads_n: the run has nothing to do")
        return self

    @model_validator(mode="after")
    def _can_wait(self) -> ProtocolSection:
        gate, hold = self.warm_up, self.adaptive_hold
        if gate is not None and gate.before == "tension" and not self.loads_n:
            raise PydanticCustomError("no_load", "warm_up waits before the first load, but there are no loads_n")
        if hold is not None and hold.max_hold_s < self.hold_s:
            raise PydanticCustomError("short_hold", "adaptive_hold.max_hold_s is shorter than hold_s")
        if hold is not None and hold.max_rate_px_s is None and hold.max_relaxation_n_s is None:
            raise PydanticCustomError("no_rate", "adaptive_hold needs max_rate_px_s or max_relaxation_n_s")
        return self
