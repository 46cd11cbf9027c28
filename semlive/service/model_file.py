"""Models with further effects: files that diagnosis writes, and that diagnosis and replay read."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from semlive.data.diagnosis import Diagnosis, FoundEffect, KnownEffect
from semlive.data.disparity import DisparityMap
from semlive.data.pair import PairDecision
from semlive.diagnose.known import at_points, family_of, moved_by
from semlive.errors import BadConfig
from semlive.model.move_effects import beside_maps
from semlive.model.row_effects import RowFamily
from semlive.service.diagnosis import effect_json, observed
from semlive.service.log_files import segments
from semlive.service.log_pairs import Maps, Words, first_run, mapped_pairs

MODEL_VERSION = 1
_BLOCK = 2**20
_Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Law(BaseModel):
    model_config = ConfigDict(extra="ignore")
    family: str
    values: dict[str, _Finite]
    size_px: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class _Effect(BaseModel):
    model_config = ConfigDict(extra="ignore")
    name: str
    law: _Law


class _File(BaseModel):
    model_config = ConfigDict(extra="ignore")
    version: int
    effects: list[_Effect]


@dataclass(frozen=True, slots=True)
class Model:
    """A model as it was read.

    Attributes:
        effects: beside raster time, drift, distortion and motion.
        sha256: of the file.
        text: of each effect, as the file has it.
    """

    effects: tuple[KnownEffect, ...] = ()
    sha256: str | None = None
    text: tuple[dict[str, Any], ...] = ()


def read_model(path: Path) -> Model:
    """A model as `semlive diagnose LOG -o FILE` writes it.

    Raises:
        BadConfig: the file cannot be read, is not a model, or has an effect that has no name here.
    """
    try:
        raw = path.read_bytes()
        plain = json.loads(raw)
        found = _File.model_validate(plain)
    except (OSError, ValueError) as error:
        said = error.errors()[0] if isinstance(error, ValidationError) else None
        what = f"{'.'.join(str(part) for part in said['loc'])}: {said['msg']}" if said else str(error)
        raise BadConfig(f"--model {path}: {what}; give a file that `semlive diagnose LOG -o FILE` wrote.") from error
    if found.version != MODEL_VERSION:
        raise BadConfig(f"--model {path}: is of version {found.version}, this program reads version {MODEL_VERSION}; diagnose again.")
    effects = []
    for one in found.effects:
        wanted = _not_linear(one.law.family)
        if wanted - set(one.law.values):
            raise BadConfig(f"--model {path}: {one.name} lacks {', '.join(sorted(wanted - set(one.law.values)))}; diagnose again.")
        effects.append(KnownEffect(one.law.family, tuple(one.law.values.items()), one.law.size_px))
    return Model(tuple(effects), hashlib.sha256(raw).hexdigest(), tuple(plain["effects"]))


def _not_linear(name: str) -> set[str]:
    beside = beside_maps(name)
    if beside is None:
        return {theta.name for theta in family_of(name).thetas}
    return {"frequency_hz"} if isinstance(beside, RowFamily) and beside.owns else set()


def model_json(found: Diagnosis, log: Path, parent: Model) -> dict[str, Any]:
    """The parent's effects with those that were found, as a file of its own."""
    return {
        "version": MODEL_VERSION,
        "parent_sha256": parent.sha256,
        "outcome": found.outcome.value,
        "effects": [*parent.text, *(_whole(one) for one in found.effects)],
        "gap_closure": None if found.gap is None else found.gap.closure,
        "run": {"end_s": found.end_s, "width_px": found.size_px[0], "height_px": found.size_px[1], **_pixel_size(log)},
        "data_sha256": _hash(log),
        "made_utc": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def write_model(path: Path, found: Diagnosis, log: Path, parent: Model) -> None:
    """Write `model_json` to a file, whole or not at all."""
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(model_json(found, log, parent), indent=1) + "\n", encoding="utf-8")
    part.replace(path)


@dataclass(frozen=True, slots=True, eq=False)
class Corrected:
    """A log whose maps a model corrects.

    Attributes:
        notes: sentences for the operator.
        log: which.
        by_frame: by the number of each frame (ny, nx, 2) what is taken out, px.
    """

    notes: tuple[str, ...]
    log: Path
    by_frame: dict[int, NDArray[np.float64]]

    def pairs(self) -> Iterator[tuple[PairDecision, Maps]]:
        """The pairs, with what the effects move taken out of their maps."""
        for decision, maps in mapped_pairs(self.log, Words()):
            yield decision, tuple(_without(one, self.by_frame) for one in maps)


def corrected(log: Path, model: Model) -> Corrected:
    """What a model's effects move in a run, fitted to all of its maps.

    Raises:
        BadInput: the log holds no maps, too few of them, or no such effect can be in them.
    """
    seen = observed(log)
    moved = moved_by(seen, [one for one in model.effects if beside_maps(one.name) is None])
    taken = [one for one in moved.effects if one not in moved.left_in]
    notes = [f"model: {', '.join(taken)} taken out of the maps; what is stated of strain does not hold their uncertainty"] if taken else []
    notes += [f"model: {one} is strain or cannot be told from it, and is left in" for one in moved.left_in]
    notes += [f"model: {one.name} is not a matter of maps, and is left in" for one in model.effects if beside_maps(one.name)]
    return Corrected(tuple(notes), log, at_points(seen, moved.field_px, seen.grid))


def _without(disparity: DisparityMap, moved: dict[int, Any]) -> DisparityMap:
    by = moved[disparity.current] - moved[disparity.reference]
    u, v = (one.copy() for one in (disparity.u_px, disparity.v_px))
    u[disparity.valid] -= by[..., 0][disparity.valid]
    v[disparity.valid] -= by[..., 1][disparity.valid]
    return replace(disparity, u_px=u, v_px=v)


def _whole(one: FoundEffect) -> dict[str, Any]:
    law = {"family": one.law.name, "values": dict(one.law.values), "size_px": one.law.size_px}
    return {
        **effect_json(one),
        "law": {**law, "amplitudes_px": list(one.amplitudes_px), "covariance_px2": [list(row) for row in one.covariance_px2]},
    }


def _pixel_size(log: Path) -> dict[str, float]:
    """Where the run's configuration says it; an imported log need not."""
    sem = first_run(log).config.get("sem")
    size = sem.get("pixel_size_um") if isinstance(sem, dict) else None
    return {"pixel_size_um": float(size)} if isinstance(size, int | float) else {}


def _hash(log: Path) -> str:
    total = hashlib.sha256()
    for path in segments(log):
        with path.open("rb") as stream:
            while block := stream.read(_BLOCK):
                total.update(block)
    return total.hexdigest()
