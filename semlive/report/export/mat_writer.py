"""MATLAB's .mat, version 5: a structure for each frame; MATLAB, Octave and scipy open it."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import savemat

from semlive.data.results import FrameResult
from semlive.report.export import fields
from semlive.report.export.fields import Array, PartFile, RunMetadata, storable

_HEADER_BYTES = 128


class MatWriter:
    """Variables ``frame_00000``, ``frame_00001``, ...; ``drift``, ``distortion``, ``series``, ``load``, ``elastic``, ``units``; JSON texts.

    The file is a header and one variable after the other, so each is written as soon as it is known and memory holds one.
    """

    def __init__(self, out: Path) -> None:
        self._part = PartFile(out)
        self._stream = self._part.path.open("wb")

    def write_frame(self, frame: FrameResult) -> None:
        """Write one frame's structure."""
        self._put(f"frame_{frame.summary.frame:05d}", _plain(fields.frame_fields(frame)))

    def write_metadata(self, story: RunMetadata) -> None:
        """Write the rest."""
        self._put("drift", _plain(fields.drift_series(story.result)))
        self._put("distortion", _plain(fields.distortion_fields(story.result)))
        self._put("series", {**_plain(fields.frame_series(story)), "phase": np.array(fields.phases(story), dtype=object)})
        if story.load is not None:
            self._put("load", _plain(fields.load_series(story.load)))
        self._put("elastic", fields.constants(story))
        self._put("units", dict(fields.UNITS))
        for name, value in (
            ("result_json", story.result_json),
            ("settings_json", story.settings),
            ("configuration_json", story.configuration),
        ):
            self._put(name, json.dumps(value))

    def close(self, complete: bool) -> None:
        """Put the file in its place, or remove what there is of it."""
        self._stream.close()
        self._part.finish(complete)

    def _put(self, name: str, value: Any) -> None:
        alone = io.BytesIO()
        savemat(alone, {name: value}, long_field_names=True, oned_as="column", do_compression=True)
        data = alone.getvalue()
        self._stream.write(data if self._stream.tell() == 0 else data[_HEADER_BYTES:])


def _plain(arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Masks as 0 and 1: logical arrays inside structures are not read by every version."""
    return {name: storable(array) for name, array in arrays.items()}
