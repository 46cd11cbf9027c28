"""Models with further effects: files that diagnosis writes, and that diagnosis, replay, plan and run read."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from semlive.data.diagnosis import EMPTY_MODEL, Diagnosis, EffectModel, IdentifiedEffect
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
from semlive.service.diagnosis.run import effect_json
from semlive.service.log.files import messages, segments
from semlive.service.log.pairs import first_run

MODEL_VERSION = 1
MOST_MODEL_BYTES = 20_000_000
"""Size of a model that is still read; an effect takes some kB."""
_BLOCK = 2**20
SAME_SIZE = 0.02  # pixels whose sizes differ by more are of another magnification


class _File(BaseModel):
    model_config = ConfigDict(extra="ignore")
    version: int
    effects: tuple[ModelEffectConfig, ...]
    run: ModelRun = ModelRun()


@dataclass(frozen=True, slots=True)
class Model:
    """A model as it was read.

    Attributes:
        section: as a configuration holds it; None is no model.
        text: of each effect, as the file has it.
        name: what to call it.
    """

    section: ModelSection | None = None
    text: tuple[dict[str, Any], ...] = ()
    name: str = "none"

    @property
    def known(self) -> EffectModel:
        """What the pipeline needs to know of it."""
        return EMPTY_MODEL if self.section is None else self.section.effect_model()


def read_model(path: Path) -> Model:
    """A model as `semlive diagnose LOG -o FILE` writes it.

    Raises:
        BadConfig: the file cannot be read, is not a model, or has an effect that has no name here.
    """
    try:
        raw = read_regular(path, MOST_MODEL_BYTES)
        plain = parse_json(raw)
        version = plain.get("version") if isinstance(plain, dict) else None
        if isinstance(version, int) and version != MODEL_VERSION:
            raise BadConfig(f"--model {path}: is of version {version}, this program reads version {MODEL_VERSION}; diagnose again.")
        found = _File.model_validate(plain)
    except (OSError, ValueError) as error:
        said = error.errors()[0] if isinstance(error, ValidationError) else None
        what = f"{'.'.join(str(part) for part in said['loc'])}: {said['msg']}" if said else str(error)
        raise BadConfig(f"--model {path}: {what}; give a file that `semlive diagnose LOG -o FILE` wrote.") from error
    _require_known(found.effects, path.name)
    section = ModelSection(sha256=hashlib.sha256(raw).hexdigest(), effects=found.effects, run=found.run)
    return Model(section, tuple(plain["effects"]), path.name)


def _require_known(effects: Iterable[ModelEffectConfig], name: str) -> None:
    """Refuse effects that cannot be predicted; a configuration does not, as its commands shall start quickly."""
    for one in effects:
        try:
            lacking = _not_linear(one.law.family) - set(one.law.values)
        except BadInput as error:
            raise BadConfig(f"--model {name}: {str(error).removeprefix('model: ')}") from error
        if lacking:
            raise BadConfig(f"--model {name}: {one.name} lacks {', '.join(sorted(lacking))}; diagnose again.")


def _not_linear(name: str) -> set[str]:
    beside = non_map_effect(name)
    if beside is None:
        return {theta.name for theta in effect_class(name).nonlinear_parameters}
    return {"frequency_hz"} if isinstance(beside, RowEffectClass) and beside.matches_frequency else set()


def model_of(log: Path) -> Model:
    """The model that a run was made with; none where it had none."""
    given = first_run(log).config.get("model")
    if given is None:
        return Model()
    section = parse_config(first_run(log).config, "the run's configuration").model
    return Model() if section is None else Model(section, tuple(one.model_dump(mode="json") for one in section.effects), "the log's own")


def config_with_model(config: Config, path: Path | None, resume: bool) -> Config:
    """A run's configuration with the model that it is asked to use; a run that is taken up again keeps the one of its log.

    Raises:
        BadConfig: it is no model, is of another magnification, or the plan has more pairs than it can be fitted to.
    """
    folder = config.run.folder / config.run.name
    if path is not None:
        model = read_model(path)
    elif resume and config.model is None and segments(folder):
        model = model_of(folder)
    else:
        model = Model(config.model, name=f"of {config.run.name}")
        _require_known(() if config.model is None else config.model.effects, model.name)
    require_compatible(model, None, config.sem.pixel_size_um)
    pairs = len(config.plan().steps)
    if model.known.effects and pairs > MAX_PAIRS:
        raise BadConfig(
            f"--model {model.name}: the plan has {pairs} pairs, and effects can be fitted to {MAX_PAIRS} together; "
            "plan fewer, or run without a model."
        )
    return config.model_copy(update={"model": model.section})


def require_compatible(model: Model, size_px: tuple[int, int] | None, pixel_size_um: float | None, what: str = "this run") -> None:
    """Refuse a model of another magnification or scan.

    Args:
        model: to be used.
        size_px: width and height of the frames; None where nothing tells.
        pixel_size_um: of the frames; None where nothing tells.
        what: it shall be used for.

    Raises:
        BadConfig: it was found at another magnification or in frames of another size.
    """
    known = model.known
    why = incompatibility_reason(known, size_px) if size_px else ""
    if why:
        raise BadConfig(f"--model {model.name}: {why} in {what}; diagnose a run with such frames.")
    own = known.pixel_size_um
    if own is not None and pixel_size_um is not None and abs(own / pixel_size_um - 1.0) > SAME_SIZE:
        raise BadConfig(
            f"--model {model.name}: it was found with pixels of {own:g} um, and those of {what} are {pixel_size_um:g} um: "
            "another magnification; diagnose a run at this one."
        )


def compatible_model(log: Path, path: Path) -> Model:
    """A model's file, to be used with a log.

    Raises:
        BadConfig: it is no model, or is of another magnification or scan than the log.
    """
    model = read_model(path)
    require_compatible(model, _frame_size(log), pixel_size_um(log), log.name)
    return model


def _frame_size(log: Path) -> tuple[int, int] | None:
    for message in messages(log):
        if message.topic == "/pair":
            pair = from_json(message.topic, message.payload)
            assert isinstance(pair, PairMessage)  # by its topic
            decision = pair_decision(pair)
            return decision.first.width_px, decision.first.height_px
    return None


def model_json(found: Diagnosis, log: Path, parent: Model) -> dict[str, Any]:
    """The parent's effects with those that were found, as a file of its own."""
    return {
        "version": MODEL_VERSION,
        "parent_sha256": None if parent.section is None else parent.section.sha256,
        "outcome": found.outcome.value,
        "effects": [*parent.text, *(_whole(one) for one in found.effects)],
        "gap_closure": None if found.gap is None else found.gap.closure,
        "run": {"end_s": found.duration_s, "width_px": found.size_px[0], "height_px": found.size_px[1], **_pixel_size(log)},
        "data_sha256": _hash(log),
        "made_utc": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def write_model(path: Path, found: Diagnosis, log: Path, parent: Model) -> None:
    """Write `model_json` to a file, whole or not at all."""
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(model_json(found, log, parent), indent=1) + "\n", encoding="utf-8")
    part.replace(path)


def _whole(one: IdentifiedEffect) -> dict[str, Any]:
    law = {"family": one.model_effect.name, "values": dict(one.model_effect.values), "size_px": one.model_effect.size_px}
    return {
        **effect_json(one),
        "law": {**law, "amplitudes_px": list(one.amplitudes_px), "covariance_px2": [list(row) for row in one.covariance_px2]},
    }


def _pixel_size(log: Path) -> dict[str, float]:
    """Where the run's configuration says it; an imported log need not."""
    size = pixel_size_um(log)
    return {} if size is None else {"pixel_size_um": size}


def pixel_size_um(log: Path) -> float | None:
    """Of a run's frames, where its configuration says it."""
    sem = first_run(log).config.get("sem")
    size = sem.get("pixel_size_um") if isinstance(sem, dict) else None
    return float(size) if isinstance(size, int | float) else None


def _hash(log: Path) -> str:
    total = hashlib.sha256()
    for path in segments(log):
        with open_regular(path) as stream:
            while block := stream.read(_BLOCK):
                total.update(block)
    return total.hexdigest()
