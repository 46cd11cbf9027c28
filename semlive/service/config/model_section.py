"""Model section of a configuration: `--model` adds it, so that it is stored in the log."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from semlive.data.diagnosis.effects import EffectModel, ModelEffect

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class ModelFieldConfig(BaseModel):
    """Basis field of an effect: parameters that predict it in any run."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    family: str
    values: dict[str, _Finite]
    size_px: _Positive


class ModelEffectConfig(BaseModel):
    """An effect of a model."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    name: str
    law: ModelFieldConfig


class ModelRun(BaseModel):
    """The run from which the effects were estimated."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    width_px: int | None = None
    height_px: int | None = None
    pixel_size_um: _Positive | None = None


class ModelSection(BaseModel):
    """Section that `--model` adds to a configuration."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sha256: str
    """SHA-256 of the model file."""
    effects: tuple[ModelEffectConfig, ...]
    run: ModelRun = ModelRun()

    def effect_model(self) -> EffectModel:
        """Return the settings of the analysis."""
        effects = tuple(ModelEffect(effect.law.family, tuple(effect.law.values.items()), effect.law.size_px) for effect in self.effects)
        width, height = self.run.width_px, self.run.height_px
        size_px = None if width is None or height is None else (width, height)
        return EffectModel(effects, size_px, self.run.pixel_size_um, self.sha256)
