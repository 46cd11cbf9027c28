"""JSON file of a qualification."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import cast

from pydantic import TypeAdapter, ValidationError

from semlive.errors import BadInput
from semlive.inputs.files import read_regular
from semlive.qualify.values import FORMAT_VERSION, Qualification

_ADAPTER = TypeAdapter(Qualification)
_MAX_BYTES = 10**7


def to_json(qualification: Qualification) -> str:
    """The qualification as one JSON object."""
    return _ADAPTER.dump_json(qualification, indent=1).decode()


def json_schema() -> Mapping[str, object]:
    """JSON schema of the file."""
    return cast(Mapping[str, object], _ADAPTER.json_schema(mode="serialization"))


def read_qualification(path: Path) -> Qualification:
    """Read a file that `semlive qualify` wrote.

    Raises:
        BadInput: the file cannot be read, or is no qualification.
    """
    try:
        found = _ADAPTER.validate_json(read_regular(path, _MAX_BYTES))
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); give a file that semlive qualify wrote") from error
    except ValidationError as error:
        where = ".".join(str(part) for part in error.errors()[0]["loc"])
        raise BadInput(f"{path}: is no qualification ({where or 'no JSON object'}); give a file that semlive qualify wrote") from error
    if found.format > FORMAT_VERSION:
        raise BadInput(f"{path}: has format {found.format}, which is newer than this program; update semlive")
    return found
