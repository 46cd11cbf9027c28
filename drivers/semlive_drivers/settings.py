"""Settings that drivers of several protocols share, and their validation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from semlive.errors import BadConfig
from semlive.inputs.kinds import changed_kind


class SerialLine(BaseModel):
    """A serial line. Keys that are not set take their values from the description of the device."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str
    baud: int | None = Field(default=None, ge=300, le=4_000_000)
    parity: Literal["none", "even", "odd"] | None = None
    stop_bits: Literal[1, 2] | None = None
    silence_s: float | None = Field(default=None, ge=0, le=1)
    slowest_s: float | None = Field(default=None, gt=0, le=3)
    echo: bool = False

    def over(self, defaults: BaseModel) -> dict[str, Any]:
        """The keys that are set here, and the defaults for all others."""
        return {**defaults.model_dump(), **self.model_dump(exclude_none=True)}


S = TypeVar("S", bound=BaseModel)


def checked(model: type[S], settings: Mapping[str, object], driver: str) -> S:
    """Validated settings.

    Args:
        model: the settings of the driver.
        settings: keys and values of the configuration.
        driver: name of the driver in an error.

    Raises:
        BadConfig: for the first key or value that is wrong.
    """
    try:
        config = model.model_validate(dict(settings))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "settings"
        allowed = f"; it has {', '.join(model.model_fields)}" if first["type"] == "extra_forbidden" else ""
        raise BadConfig(f"{driver}: {key}: {first['msg'][0].lower()}{first['msg'][1:]}{allowed}") from None
    changed = changed_kind(settings, config)
    if changed is not None:
        raise BadConfig(f"{driver}: {'.'.join(map(str, changed[0]))}: {changed[1]}")
    return config
