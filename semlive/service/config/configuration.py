"""Configuration file: YAML, validated by pydantic, converted to the data classes of semlive."""

from __future__ import annotations

import dataclasses
import difflib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from semlive.data.diagnosis.effects import EMPTY_MODEL
from semlive.data.experiment import AdaptiveHold, HoldRule, Limits, Phase, Plan, Recentre, Step, WarmUp
from semlive.data.settings import AnalysisSettings, DicSettings, EstimateSettings, ScanProfile, ScanSpeed, SpecimenSettings
from semlive.errors import BadConfig
from semlive.inputs.files import read_regular
from semlive.inputs.kinds import Place, changed_kind
from semlive.inputs.yaml_text import MOST_BYTES, YamlText, read_yaml
from semlive.service.config.checks import contradictions
from semlive.service.config.model_section import ModelSection
from semlive.service.watch.watch_settings import WatchSettings


def known_keys(cls: type, given: object) -> object:
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


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _no_unknown_keys(cls, given: Any) -> Any:
        if isinstance(given, dict):
            names = list(cls.model_fields)
            for key in given:
                if key not in names:
                    raise PydanticCustomError("unknown_key", "{hint}", {"key": str(key), "hint": _hint(str(key), names)})
        return given


class RunSection(_Section):
    """Where the run goes."""

    name: str = Field(default="run", pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    folder: Path = Path("runs")
    """Folder in which the log is written, relative to the configuration file."""
    clock_file: Path | None = None
    """Clock published by a simulator; without it experiment time is this computer's UTC."""
    segment_gb: float = Field(default=2.0, gt=0)
    """A segment of the log that has become larger, in 10^9 bytes, is ended and the next begun."""


class DriverSection(_Section):
    """A device and the driver that speaks to it."""

    driver: str
    settings: dict[str, Any] = {}
    poll_s: float = Field(default=0.05, gt=0, le=10)
    """Wall seconds between readings."""


class SemSection(_Section):
    """The SEM's export folder and what its files do not tell."""

    folder: Path
    pixel_size_um: float = Field(gt=0)
    """Turns shifts in px into stage motion; a file's own pixel size wins in the analysis."""
    poll_s: float = Field(default=1.0, gt=0)
    stable_for_s: float = Field(default=2.0, gt=0)
    """Wall seconds without change before a file is believed complete."""
    vendor: Literal["fei", "zeiss", "tescan", "jeol", "hitachi"] | None = None
    """Whose files they are: none counts as complete without this vendor's header, or the text file beside it (JEOL, Hitachi)."""
    sidecar_timeout_s: float = Field(default=60.0, gt=0)
    """Wall seconds after which a file without the text file of its vendor is refused."""
    probe_share: bool = False
    """Ask the folder's computer for its time, when the run begins, by writing a small file there."""
    trigger: DriverSection | None = None
    profile: Annotated[ScanProfile, BeforeValidator(lambda v: known_keys(ScanProfile, v))] = ScanProfile()
    scan_profiles: list[Annotated[ScanSpeed, BeforeValidator(lambda v: known_keys(ScanSpeed, v))]] = []
    """Scan times by the vendor's name for a scan speed, for files that do not tell times."""

    @property
    def whole_profile(self) -> ScanProfile:
        """All that the user says of files whose vendor does not."""
        return dataclasses.replace(self.profile, speeds=(*self.profile.speeds, *self.scan_profiles))


class WarmUpSection(_Section):
    """The warm-up gate: how slow the drift must be before the first load."""

    max_rate_px_s: float = Field(gt=0)
    """Forecast drift rate plus its standard uncertainty; until then further pairs are taken at the place of the step to come."""
    max_wait_s: float = Field(default=1800.0, gt=0)
    """After this long the operator is asked."""
    before: Literal["calibration", "tension"] = "tension"
    """`calibration`: the gate is after the first pair already."""


class AdaptiveHoldSection(_Section):
    """When a hold lasts longer than `hold_s`; it never lasts less."""

    max_hold_s: float = Field(gt=0)
    max_rate_px_s: float | None = Field(default=None, gt=0)
    """Drift rate: between frames of the hold where there are any, else its forecast."""
    max_relaxation_n_s: float | None = Field(default=None, gt=0)
    """Change of the load."""


class ProtocolSection(_Section):
    """What the experiment does."""

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
    """Before each step, take back what drift carried the field of view away, if it is more than this; leave out to let it go."""
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


class Config(_Section):
    """A whole configuration file."""

    run: RunSection = RunSection()
    sem: SemSection
    load_frame: DriverSection | None = None
    stage: DriverSection | None = None
    specimen: Annotated[SpecimenSettings, BeforeValidator(lambda v: known_keys(SpecimenSettings, v))] = SpecimenSettings()
    protocol: ProtocolSection
    limits: Annotated[Limits, BeforeValidator(lambda v: known_keys(Limits, v))] | None = None
    dic: Annotated[DicSettings, BeforeValidator(lambda v: known_keys(DicSettings, v))] = DicSettings()
    estimate: Annotated[EstimateSettings, BeforeValidator(lambda v: known_keys(EstimateSettings, v))] = EstimateSettings()
    model: ModelSection | None = None
    """Effects that are taken out of the maps; `--model` puts them here."""
    confirmed_unusual: list[str] = []
    """Keys of implausible values that are meant (`semlive.service.config.plausibility`)."""

    @model_validator(mode="after")
    def _devices_fit_protocol(self) -> Config:
        protocol = self.protocol
        asks_forecast = protocol.warm_up or (protocol.adaptive_hold and protocol.adaptive_hold.max_rate_px_s)
        if asks_forecast and self.estimate.method != "joint":
            raise PydanticCustomError(
                "no_forecast", "protocol.warm_up and adaptive_hold need estimate.method joint, which forecasts the drift"
            )
        if protocol.loads_n and self.load_frame is None:
            raise PydanticCustomError("no_frame", "protocol.loads_n needs a load_frame section")
        if self.load_frame is not None and self.limits is None:
            raise PydanticCustomError("no_limits", "a load_frame needs a limits section (force, extension, rate)")
        shifts = protocol.calibration_shifts_px + protocol.translation_shifts_px
        if (protocol.recentre_beyond_px is not None or any(shift != (0, 0) for shift in shifts)) and self.stage is None:
            raise PydanticCustomError("no_stage", "shifts need a stage section (driver: operator asks a hand to move the specimen)")
        return self

    def watch_settings(self) -> WatchSettings:
        """What is watched, and when a file is believed complete."""
        sem = self.sem
        return WatchSettings(
            folder=sem.folder,
            poll_s=sem.poll_s,
            stable_for_s=sem.stable_for_s,
            vendor=sem.vendor,
            sidecar_timeout_s=sem.sidecar_timeout_s,
            profile=sem.whole_profile,
        )

    def analysis_settings(self) -> AnalysisSettings:
        """Return the settings of the analysis."""
        model = EMPTY_MODEL if self.model is None else self.model.known()
        return AnalysisSettings(self.dic, self.estimate, self.specimen, self.sem.whole_profile, model)

    def plan(self) -> Plan:
        """The experiment as steps: calibration shifts, translations, then loads at shift zero."""
        protocol, um = self.protocol, self.sem.pixel_size_um
        unloaded = [(Phase.CALIBRATION, shift) for shift in protocol.calibration_shifts_px]
        unloaded += [(Phase.TRANSLATION, shift) for shift in protocol.translation_shifts_px]
        stops = [(phase, shift, None) for phase, shift in unloaded]
        stops += [(Phase.TENSION, (0.0, 0.0), load) for load in protocol.loads_n]
        steps = tuple(Step(number, phase, (shift[0] * um, shift[1] * um), shift, load) for number, (phase, shift, load) in enumerate(stops))
        hold = HoldRule(**{field.name: getattr(protocol, field.name) for field in dataclasses.fields(HoldRule)})
        limits = self.limits or _NO_MOTION
        recentre = None if protocol.recentre_beyond_px is None else Recentre(protocol.recentre_beyond_px, um)
        return Plan(
            steps,
            hold,
            limits,
            protocol.ramp_rate_n_s,
            triggered=self.sem.trigger is not None,
            recentring=recentre,
            warm_up=_warm_up(protocol.warm_up),
            adaptive_hold=None if protocol.adaptive_hold is None else AdaptiveHold(**protocol.adaptive_hold.model_dump()),
            # Who translates nothing asks for no distortion.
            calibration_gate=any(shift != (0, 0) for _, shift in unloaded) and not self.estimate.accept_poor_calibration,
        )


def _warm_up(gate: WarmUpSection | None) -> WarmUp | None:
    return None if gate is None else WarmUp(gate.max_rate_px_s, gate.max_wait_s, Phase(gate.before))


# Without a load frame nothing pulls; the stage keeps a generous travel of 1 mm.
_NO_MOTION = Limits(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, stage_travel_um=1000.0)


def load_config(path: Path) -> Config:
    """Read and check a configuration file; relative folders in it are relative to the file.

    Raises:
        BadConfig: the file is missing, is not YAML, or says something semlive does not understand.
    """
    try:
        data = read_regular(path, MOST_BYTES)
    except OSError as error:
        raise BadConfig(f"{path}: cannot be read ({_reason(error)}); give the path of a YAML configuration file") from error
    return resolve_paths(checked_text(read_yaml(data, str(path)), str(path)), path.parent)


def checked_text(text: YamlText, where: str) -> Config:
    """The configuration that a YAML text holds, checked more strictly than that of an earlier run's log.

    Args:
        text: as it was read.
        where: what error messages begin with, the file's name.

    Raises:
        BadConfig: naming line and key of the first thing that is wrong.
    """
    config = parse_config(text.value, where, text)
    changed = changed_kind(text.value, config)
    if changed is not None:
        raise BadConfig(f"{where}: {_at(text, changed[0])}{'.'.join(map(str, changed[0]))}: {changed[1]}")
    _readings_stay_fresh(config, where)
    for one in contradictions(config):
        raise BadConfig(f"{where}: {_at(text, one.place)}{'.'.join(map(str, one.place))}: {one.what}")
    return config


def _readings_stay_fresh(config: Config, where: str) -> None:
    """Check the polling interval, because slow polling would stop the run; checked here, so that logs of earlier runs stay readable."""
    stale_s = (config.limits or _NO_MOTION).stale_after_s
    for name, section in (("load_frame", config.load_frame), ("stage", config.stage)):
        if section is not None and section.poll_s >= stale_s:
            raise BadConfig(
                f"{where}: {name}.poll_s: {section.poll_s:g} s between readings, which are stale after limits.stale_after_s, "
                f"{stale_s:g} s; read more often"
            )


def parse_config(given: object, where: str, text: YamlText | None = None) -> Config:
    """Check what a YAML file said.

    Args:
        given: the file's content as dictionaries, lists and values.
        where: what error messages begin with, the file's name.
        text: of the file, which knows the lines; None where there is no file.

    Raises:
        BadConfig: naming the first key that is wrong, and where.
    """
    if not isinstance(given, dict):
        raise BadConfig(f"{where}: holds no sections; it must begin with keys such as sem: and protocol:")
    try:
        return Config.model_validate(given)
    except ValidationError as error:
        first = error.errors()[0]
        key = (first.get("ctx") or {}).get("key")
        line = "" if text is None else _at(text, first["loc"] if key is None else (*first["loc"], str(key)))
        raise BadConfig(f"{where}: {line}{_sentence(first)}") from error


def resolve_paths(config: Config, base: Path) -> Config:
    """The same configuration with its folders made absolute from `base`."""
    clock_file = config.run.clock_file
    run = config.run.model_copy(
        update={"folder": (base / config.run.folder).resolve(), "clock_file": clock_file and (base / clock_file).resolve()}
    )
    sem = config.sem.model_copy(update={"folder": (base / config.sem.folder).resolve()})
    return config.model_copy(update={"run": run, "sem": sem})


def _at(text: YamlText, place: Place) -> str:
    line = text.line(place)
    return "" if line is None else f"line {line}: "


def _sentence(detail: ErrorDetails) -> str:
    place = ".".join(str(part) for part in detail["loc"])
    if detail["type"] == "unknown_key":
        context = detail.get("ctx") or {}
        key = f"{place}.{context['key']}" if place else str(context["key"])
        return f"unknown key {key}; {context['hint']}"
    if detail["type"] == "missing":
        return f"{place} is missing; add it"
    message = detail["msg"].removeprefix("Value error, ")
    return f"{place}: {message}; correct it" if place else f"{message}; correct it"


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or type(error).__name__
