"""Analysis settings from the `/run` message of a log: the configuration of a run or of an import."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from semlive.data.settings import AnalysisSettings, EstimateSettings, SpecimenSettings
from semlive.errors import BadLog
from semlive.formats.log.messages import RunMessage
from semlive.service.config.configuration import parse_config
from semlive.service.config.sections import reject_unknown_keys

IMPORTED = "imported"


class ImportNoise(BaseModel):
    """Correlation of the maps' noise over neighbouring points.

    Attributes:
        subset_px: edge of the subset of all maps of the log, px: points in it are worth one; 0 for independent points.
        source: ``given`` by the option, ``maps`` for the value in the maps, ``estimated`` from their noise, or ``assumed``.
        edge_px: edge of the square with the estimated area of correlation, px; `subset_px` is at most a sixth of the field.
        sigma_px: standard deviations of u and v of maps within pairs, px, if estimated.
        gaussian: share of a Gaussian in the window, 0 to 1, if estimated.
        own_fraction: fraction of the variance that is each point's own, if estimated.
        maps: number of maps in the estimate.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    subset_px: int
    source: Literal["given", "maps", "estimated", "assumed"]
    edge_px: float | None = None
    sigma_px: tuple[float, float] | None = None
    gaussian: float | None = None
    own_fraction: float | None = None
    maps: int = 0


class ImportSection(BaseModel):
    """Source of the disparity maps."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal[1] = 1
    folder: str
    engines: tuple[str, ...]
    noise: ImportNoise | None = None
    hold_s: float | None = Field(default=None, ge=0)


class ImportConfig(BaseModel):
    """Configuration of an imported log, which has no run."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    imported: ImportSection
    specimen: Annotated[SpecimenSettings, BeforeValidator(lambda v: reject_unknown_keys(SpecimenSettings, v))] = SpecimenSettings()
    estimate: Annotated[EstimateSettings, BeforeValidator(lambda v: reject_unknown_keys(EstimateSettings, v))] = EstimateSettings()


def is_imported(config: dict[str, Any]) -> bool:
    """Whether a log's configuration is that of an import."""
    return IMPORTED in config


def settings_of(message: RunMessage) -> AnalysisSettings:
    """The analysis settings of a log.

    Raises:
        BadInput: the configuration is not one that this version understands.
    """
    if not is_imported(message.config):
        return parse_config(message.config, "the run's configuration").analysis_settings()
    try:
        config = ImportConfig.model_validate(message.config)
    except ValidationError as error:
        place = ".".join(str(part) for part in error.errors()[0]["loc"])
        raise BadLog(
            f"the import's configuration: {place}: {error.errors()[0]['msg']}; read this log with the version of semlive that wrote it"
        ) from error
    return AnalysisSettings(specimen=config.specimen, estimate=config.estimate)
