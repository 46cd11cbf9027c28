"""Configuration file: YAML, validated by pydantic, and converted to the data classes of semlive."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from semlive.data.diagnosis.effects import EMPTY_MODEL
from semlive.data.experiment import AdaptiveHold, HoldRule, Limits, Phase, Plan, Recentre, Step, WarmUp
from semlive.data.settings import AnalysisSettings, DicSettings, EstimateSettings, SpecimenSettings
from semlive.errors import BadConfig
from semlive.inputs.files import read_regular
from semlive.inputs.kinds import Place, changed_kind
from semlive.inputs.yaml_text import MOST_BYTES, YamlText, read_yaml
from semlive.service.config.checks import contradictions
from semlive.service.config.mask import with_mask
from semlive.service.config.model_section import ModelSection
from semlive.service.config.sections import (
    AlertsSection,
    DriverSection,
    ProtocolSection,
    RunSection,
    Section,
    SemSection,
    WarmUpSection,
    reject_unknown_keys,
)
from semlive.service.watch.export_folder import WatchSettings


class Config(Section):
    """A configuration file."""

    run: RunSection = RunSection()
    sem: SemSection
    load_frame: DriverSection | None = None
    stage: DriverSection | None = None
    specimen: Annotated[SpecimenSettings, BeforeValidator(lambda v: reject_unknown_keys(SpecimenSettings, v))] = SpecimenSettings()
    protocol: ProtocolSection
    limits: Annotated[Limits, BeforeValidator(lambda v: reject_unknown_keys(Limits, v))] | None = None
    alerts: AlertsSection | None = None
    """Alerts by webhook, e-mail or messenger; without the section none are sent."""
    dic: Annotated[DicSettings, BeforeValidator(lambda v: reject_unknown_keys(DicSettings, v))] = DicSettings()
    estimate: Annotated[EstimateSettings, BeforeValidator(lambda v: reject_unknown_keys(EstimateSettings, v))] = EstimateSettings()
    model: ModelSection | None = None
    """Effects that are corrected in the maps; `--model` adds them here."""
    confirmed_unusual: list[str] = Field(default_factory=list)
    """Keys whose implausible values are intended (`semlive.service.config.plausibility`)."""

    @model_validator(mode="before")
    @classmethod
    def _limits_without_load_frame(cls, given: Any) -> Any:
        """Complete the limits, which without a load frame bound the stage and the age of readings only."""
        if isinstance(given, dict) and given.get("load_frame") is None and isinstance(given.get("limits"), dict):
            return {**given, "limits": {**dataclasses.asdict(_NO_LOAD_LIMITS), **given["limits"]}}
        return given

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
            raise PydanticCustomError("no_stage", "shifts need a stage section (with driver: operator, the operator moves the specimen)")
        return self

    def watch_settings(self) -> WatchSettings:
        """Return the settings of the watched folder, and of complete files."""
        sem = self.sem
        return WatchSettings(
            folder=sem.folder,
            poll_s=sem.poll_s,
            use_events=sem.file_events,
            stable_for_s=sem.stable_for_s,
            vendor=sem.vendor,
            row_clock=sem.row_clock,
            sidecar_timeout_s=sem.sidecar_timeout_s,
            profile=sem.scan_profile,
        )

    def analysis_settings(self) -> AnalysisSettings:
        """Return the settings of the analysis."""
        model = EMPTY_MODEL if self.model is None else self.model.effect_model()
        return AnalysisSettings(self.dic, self.estimate, self.specimen, self.sem.scan_profile, model)

    def plan(self) -> Plan:
        """Return the experiment as steps: calibration shifts, translations, then loads at shift zero."""
        protocol, um = self.protocol, self.sem.pixel_size_um
        unloaded = [(Phase.CALIBRATION, shift) for shift in protocol.calibration_shifts_px]
        unloaded += [(Phase.TRANSLATION, shift) for shift in protocol.translation_shifts_px]
        stops = [(phase, shift, None) for phase, shift in unloaded]
        stops += [(Phase.TENSION, (0.0, 0.0), load) for load in protocol.loads_n]
        steps = tuple(Step(number, phase, (shift[0] * um, shift[1] * um), shift, load) for number, (phase, shift, load) in enumerate(stops))
        hold = HoldRule(**{field.name: getattr(protocol, field.name) for field in dataclasses.fields(HoldRule)})
        limits = self.limits or _NO_LOAD_LIMITS
        recentre = None if protocol.recentre_beyond_px is None else Recentre(protocol.recentre_beyond_px, um)
        return Plan(
            steps,
            hold,
            limits,
            protocol.ramp_rate_n_s,
            triggered=self.sem.trigger is not None,
            recentring=recentre,
            warm_up=_warm_up_rule(protocol.warm_up),
            adaptive_hold=None if protocol.adaptive_hold is None else AdaptiveHold(**protocol.adaptive_hold.model_dump()),
            # Without translations the distortion is not estimated.
            calibration_gate=any(shift != (0, 0) for _, shift in unloaded) and not self.estimate.accept_poor_calibration,
        )


def _warm_up_rule(gate: WarmUpSection | None) -> WarmUp | None:
    if gate is None:
        return None
    return WarmUp(gate.max_rate_px_s, gate.max_wait_s, Phase(gate.before), gate.max_change_px_s, gate.after_wait == "continue")


# Limits without a load frame: no load, and 1 mm of stage travel.
_NO_LOAD_LIMITS = Limits(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, stage_travel_um=1000.0)


def load_config(path: Path) -> Config:
    """Read and check a configuration file; relative folders in it are relative to the file.

    Raises:
        BadConfig: the file is missing, is not YAML, or has an invalid key or value.
    """
    try:
        data = read_regular(path, MOST_BYTES)
    except OSError as error:
        raise BadConfig(f"{path}: cannot be read ({_reason(error)}); give the path of a YAML configuration file") from error
    text = read_yaml(data, str(path))
    config = checked_text(text, str(path))
    try:
        return resolve_paths(config, path.parent)
    except BadConfig as error:
        raise BadConfig(f"{path}: {_at(text, ('dic', 'mask'))}{error}") from error


def checked_text(text: YamlText, where: str) -> Config:
    """Return the configuration of a YAML text; the checks are stricter than those for the log of an earlier run.

    Args:
        text: YAML text with line numbers.
        where: name of the file, with which error messages begin.

    Raises:
        BadConfig: a value is invalid; the message names line and key of the first one.
    """
    config = parse_config(text.value, where, text)
    changed = changed_kind(text.value, config)
    if changed is not None:
        raise BadConfig(f"{where}: {_at(text, changed[0])}{'.'.join(map(str, changed[0]))}: {changed[1]}")
    _readings_stay_fresh(config, where)
    for contradiction in contradictions(config):
        raise BadConfig(f"{where}: {_at(text, contradiction.place)}{'.'.join(map(str, contradiction.place))}: {contradiction.what}")
    return config


def _readings_stay_fresh(config: Config, where: str) -> None:
    """Check the polling interval, because slow polling would stop the run; checked for files only, so that old logs stay readable."""
    stale_s = (config.limits or _NO_LOAD_LIMITS).stale_after_s
    for name, section in (("load_frame", config.load_frame), ("stage", config.stage)):
        if section is not None and section.poll_s >= stale_s:
            raise BadConfig(
                f"{where}: {name}.poll_s: {section.poll_s:g} s between readings, which are stale after limits.stale_after_s, "
                f"{stale_s:g} s; read more often"
            )


def parse_config(given: object, where: str, text: YamlText | None = None) -> Config:
    """Return the configuration of the content of a YAML file.

    Args:
        given: content of the file as dictionaries, lists and values.
        where: name of the file, with which error messages begin.
        text: text of the file with line numbers; None without a file.

    Raises:
        BadConfig: a key is invalid; the message names the first one and its place.
    """
    if not isinstance(given, dict):
        raise BadConfig(f"{where}: there are no sections; begin with keys such as sem: and protocol:")
    try:
        return Config.model_validate(given)
    except ValidationError as error:
        first = error.errors()[0]
        key = (first.get("ctx") or {}).get("key")
        line = "" if text is None else _at(text, first["loc"] if key is None else (*first["loc"], str(key)))
        raise BadConfig(f"{where}: {line}{_error_text(first)}") from error


def resolve_paths(config: Config, base: Path) -> Config:
    """Return the configuration with absolute paths, and the bytes of the mask; relative paths refer to `base`.

    Raises:
        BadConfig: the mask cannot be used.
    """
    clock_file = config.run.clock_file
    run = config.run.model_copy(
        update={"folder": (base / config.run.folder).resolve(), "clock_file": clock_file and (base / clock_file).resolve()}
    )
    sem = config.sem.model_copy(update={"folder": (base / config.sem.folder).resolve()})
    alerts = config.alerts and config.alerts.model_copy(update={"file": (base / config.alerts.file).resolve()})
    return config.model_copy(update={"run": run, "sem": sem, "alerts": alerts, "dic": with_mask(config.dic, base)})


def _at(text: YamlText, place: Place) -> str:
    line = text.line(place)
    return "" if line is None else f"line {line}: "


def _error_text(detail: ErrorDetails) -> str:
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
