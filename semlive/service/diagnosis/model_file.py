"""Model files with further effects: written by `diagnose`, read by `diagnose`, `replay`, `plan` and `run`."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from semlive.data.diagnosis.effects import EMPTY_MODEL, EffectModel, IdentifiedEffect
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.errors import BadConfig, BadInput
from semlive.formats.log.conversions import pair_decision
from semlive.formats.log.messages import PairMessage, from_json
from semlive.inputs.files import open_regular, read_regular
from semlive.inputs.json_text import parse_json
from semlive.model.effects.rows import RowEffectClass
from semlive.model.effects.stage import non_map_effect
from semlive.pipeline.effect_correction import MAX_PAIRS, incompatibility_reason
from semlive.service.config.configuration import Config, parse_config
from semlive.service.config.model_section import ModelEffectConfig, ModelRun, ModelSection
from semlive.service.diagnosis.verdict_json import effect_json
from semlive.service.log.files import segments
from semlive.service.log.opened_log import OpenedLog

MODEL_VERSION = 1
MAX_MODEL_BYTES = 20_000_000
"""Largest accepted model file; an effect takes some kB."""
_BLOCK = 2**20
SAME_SIZE = 0.02  # largest relative difference of pixel sizes at equal magnification


class _File(BaseModel):
    model_config = ConfigDict(extra="ignore")
    version: int
    effects: tuple[ModelEffectConfig, ...]
    run: ModelRun = ModelRun()


@dataclass(frozen=True, slots=True)
class Model:
    """A model read from a file or a configuration.

    Attributes:
        section: model section of the configuration; None without a model.
        text: JSON object of each effect in the file.
        name: name for messages.
    """

    section: ModelSection | None = None
    text: tuple[dict[str, object], ...] = ()
    name: str = "none"

    @property
    def effect_model(self) -> EffectModel:
        """Effects for the pipeline."""
        return EMPTY_MODEL if self.section is None else self.section.effect_model()


def read_model(path: Path) -> Model:
    """Read a model written by `semlive diagnose LOG -o FILE`.

    Raises:
        BadConfig: the file cannot be read, is not a model, or contains an effect that is not in the dictionary.
    """
    try:
        raw = read_regular(path, MAX_MODEL_BYTES)
        plain = parse_json(raw)
        version = plain.get("version") if isinstance(plain, dict) else None
        if isinstance(version, int) and version != MODEL_VERSION:
            raise BadConfig(f"--model {path}: has version {version}, this program reads version {MODEL_VERSION}; diagnose again.")
        content = _File.model_validate(plain)
    except (OSError, ValueError) as error:
        first_error = error.errors()[0] if isinstance(error, ValidationError) else None
        what = f"{'.'.join(str(part) for part in first_error['loc'])}: {first_error['msg']}" if first_error else str(error)
        raise BadConfig(f"--model {path}: {what}; give a file that `semlive diagnose LOG -o FILE` wrote.") from error
    _require_in_dictionary(content.effects, path.name)
    section = ModelSection(sha256=hashlib.sha256(raw).hexdigest(), effects=content.effects, run=content.run)
    return Model(section, tuple(plain["effects"]), path.name)


def _require_in_dictionary(effects: Iterable[ModelEffectConfig], name: str) -> None:
    """Reject effects that cannot be predicted; the configuration does not check this, because its commands must start quickly."""
    for effect in effects:
        try:
            lacking = _required_parameters(effect.law.family) - set(effect.law.values)
        except BadInput as error:
            raise BadConfig(f"--model {name}: {str(error).removeprefix('model: ')}") from error
        if lacking:
            raise BadConfig(f"--model {name}: {effect.name} lacks {', '.join(sorted(lacking))}; diagnose again.")


def _required_parameters(name: str) -> set[str]:
    non_map = non_map_effect(name)
    if non_map is None:
        return {theta.name for theta in effect_class(name).nonlinear_parameters}
    return {"frequency_hz"} if isinstance(non_map, RowEffectClass) and non_map.matches_frequency else set()


def model_of(log: OpenedLog) -> Model:
    """The model that a run used; an empty model if it used none."""
    config = log.run.config
    if config.get("model") is None:
        return Model()
    section = parse_config(config, "the run's configuration").model
    return (
        Model() if section is None else Model(section, tuple(effect.model_dump(mode="json") for effect in section.effects), "the log's own")
    )


def config_with_model(config: Config, path: Path | None, resume: bool) -> Config:
    """Configuration of a run with its model; a resumed run keeps the model of its log.

    Raises:
        BadConfig: the file is no model, belongs to another magnification, or the plan has too many pairs for a fit.
    """
    folder = config.run.folder / config.run.name
    if path is not None:
        model = read_model(path)
    elif resume and config.model is None and segments(folder):
        model = model_of(OpenedLog(folder))
    else:
        model = Model(config.model, name=f"of {config.run.name}")
        _require_in_dictionary(() if config.model is None else config.model.effects, model.name)
    require_compatible(model, None, config.sem.pixel_size_um)
    pairs = len(config.plan().steps)
    if model.effect_model.effects and pairs > MAX_PAIRS:
        raise BadConfig(
            f"--model {model.name}: the plan has {pairs} pairs, and effects can be fitted to at most {MAX_PAIRS}; "
            "plan fewer, or run without a model."
        )
    return config.model_copy(update={"model": model.section})


def require_compatible(model: Model, size_px: tuple[int, int] | None, pixel_size_um: float | None, what: str = "this run") -> None:
    """Reject a model of another magnification or frame size.

    Args:
        model: the model.
        size_px: width and height of the frames; None if unknown.
        pixel_size_um: pixel size of the frames; None if unknown.
        what: name of the run or log, for messages.

    Raises:
        BadConfig: the model belongs to another magnification or frame size.
    """
    model_effects = model.effect_model
    why = incompatibility_reason(model_effects, size_px) if size_px else ""
    if why:
        raise BadConfig(f"--model {model.name}: {why} in {what}; diagnose a run with such frames.")
    own = model_effects.pixel_size_um
    if own is not None and pixel_size_um is not None and abs(own / pixel_size_um - 1.0) > SAME_SIZE:
        raise BadConfig(
            f"--model {model.name}: its effects were identified with pixels of {own:g} um, and those of {what} are {pixel_size_um:g} um: "
            "another magnification; diagnose a run at this one."
        )


def compatible_model(log: OpenedLog, path: Path) -> Model:
    """Read a model for use with a log.

    Raises:
        BadConfig: the file is no model, or belongs to another magnification or frame size than the log.
    """
    model = read_model(path)
    require_compatible(model, _frame_size(log), pixel_size_um(log), log.path.name)
    return model


def _frame_size(log: OpenedLog) -> tuple[int, int] | None:
    message = log.first("/pair")
    if message is None:
        return None
    pair = from_json(message.topic, message.payload)
    assert isinstance(pair, PairMessage)  # by its topic
    decision = pair_decision(pair)
    return decision.first.width_px, decision.first.height_px


def model_json(verdict: Diagnosis, log: OpenedLog, parent: Model) -> dict[str, object]:
    """Content of a model file: the effects of the parent model and the identified ones."""
    return {
        "version": MODEL_VERSION,
        "parent_sha256": None if parent.section is None else parent.section.sha256,
        "outcome": verdict.outcome.value,
        "effects": [*parent.text, *(_effect_entry(effect) for effect in verdict.effects)],
        "gap_closure": None if verdict.gap is None else verdict.gap.closure,
        "run": {
            "end_s": verdict.run.duration_s,
            "width_px": verdict.run.size_px[0],
            "height_px": verdict.run.size_px[1],
            **_pixel_size(log),
        },
        "data_sha256": _hash(log.path),
        "made_utc": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def write_model(path: Path, verdict: Diagnosis, log: OpenedLog, parent: Model) -> None:
    """Write `model_json` to a file atomically."""
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(model_json(verdict, log, parent), indent=1) + "\n", encoding="utf-8")
    part.replace(path)


def _effect_entry(effect: IdentifiedEffect) -> dict[str, object]:
    basis_field = {"family": effect.model_effect.name, "values": dict(effect.model_effect.values), "size_px": effect.model_effect.size_px}
    return {
        **effect_json(effect),
        "law": {**basis_field, "amplitudes_px": list(effect.amplitudes_px), "covariance_px2": [list(row) for row in effect.covariance_px2]},
    }


def _pixel_size(log: OpenedLog) -> dict[str, float]:
    """Pixel size from the configuration of the run; empty for imported logs without it."""
    size = pixel_size_um(log)
    return {} if size is None else {"pixel_size_um": size}


def pixel_size_um(log: OpenedLog) -> float | None:
    """Pixel size of a run's frames from its configuration, um; None if unknown."""
    sem = log.run.config.get("sem")
    size = sem.get("pixel_size_um") if isinstance(sem, dict) else None
    return float(size) if isinstance(size, int | float) else None


def _hash(log: Path) -> str:
    total = hashlib.sha256()
    for path in segments(log):
        with open_regular(path) as stream:
            while block := stream.read(_BLOCK):
                total.update(block)
    return total.hexdigest()
