"""A model as a run's configuration holds it: `--model` puts it there, so whatever reads the log has it too."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from semlive.data.diagnosis import KnownEffect, KnownModel
from semlive.diagnose.known import family_of
from semlive.errors import BadInput
from semlive.model.move_effects import beside_maps
from semlive.model.row_effects import RowFamily

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class ModelLaw(BaseModel):
    """Enough of an effect to predict it in any run."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    family: str
    values: dict[str, _Finite]
    size_px: _Positive


class ModelEffect(BaseModel):
    """An effect of a model."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    name: str
    law: ModelLaw

    @model_validator(mode="after")
    def _can_be_predicted(self) -> ModelEffect:
        try:
            lacking = _not_linear(self.law.family) - set(self.law.values)
        except BadInput as error:
            raise PydanticCustomError("unknown_effect", "{why}", {"why": str(error).removeprefix("model: ").rstrip(".")}) from error
        if lacking:
            raise PydanticCustomError("no_value", "{name} lacks {what}", {"name": self.name, "what": ", ".join(sorted(lacking))})
        return self


class ModelRun(BaseModel):
    """The run that a model was found in."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    width_px: int | None = None
    height_px: int | None = None
    pixel_size_um: _Positive | None = None


class ModelSection(BaseModel):
    """What `--model` adds to a configuration."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sha256: str
    """Of the file."""
    effects: tuple[ModelEffect, ...]
    run: ModelRun = ModelRun()

    def known(self) -> KnownModel:
        """What the pipeline needs to know of it."""
        effects = tuple(KnownEffect(one.law.family, tuple(one.law.values.items()), one.law.size_px) for one in self.effects)
        width, height = self.run.width_px, self.run.height_px
        size_px = None if width is None or height is None else (width, height)
        return KnownModel(effects, size_px, self.run.pixel_size_um, self.sha256)


def _not_linear(name: str) -> set[str]:
    beside = beside_maps(name)
    if beside is None:
        return {theta.name for theta in family_of(name).thetas}
    return {"frequency_hz"} if isinstance(beside, RowFamily) and beside.owns else set()
