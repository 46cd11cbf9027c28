"""MATLAB's .mat, version 5: a structure for each frame; MATLAB, Octave and scipy open it."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.io import savemat

from semlive.data.results import FrameResult
from semlive.report.export import fields
from semlive.report.export.fields import Array, PartFile, RunMetadata, storable

_HEADER_BYTES = 128


class MatWriter:
    """Variables ``frame_00000``, ``frame_00001``, ...; ``drift``, ``distortion``, ``series``, ``load``, ``elastic``, ``units``; JSON texts.

    The file is a header followed by the variables, so each variable is written when it is available, and memory holds only one.
    """

    def __init__(self, out: Path) -> None:
        self._part = PartFile(out)
        self._stream = self._part.path.open("wb")

    def write_frame(self, frame: FrameResult) -> None:
        """Write one frame's structure."""
        self._put(f"frame_{frame.summary.frame:05d}", _plain(fields.frame_fields(frame)))

    def write_metadata(self, metadata: RunMetadata) -> None:
        """Write the rest."""
        self._put("drift", _plain(fields.drift_series(metadata.result)))
        self._put("distortion", _plain(fields.distortion_fields(metadata.result)))
        self._put("series", {**_plain(fields.frame_series(metadata)), "phase": np.array(fields.phases(metadata), dtype=object)})
        if metadata.load is not None:
            self._put("load", _plain(fields.load_series(metadata.load)))
        self._put("elastic", fields.constants(metadata))
        self._put("units", dict(fields.UNITS))
        for name, value in (
            ("result_json", metadata.result_json),
            ("settings_json", metadata.settings),
            ("configuration_json", metadata.configuration),
        ):
            self._put(name, json.dumps(value))

    def close(self, complete: bool) -> None:
        """Rename the complete file to its final name, or remove an incomplete one."""
        self._stream.close()
        self._part.finish(complete)

    def _put(self, name: str, value: object) -> None:
        alone = io.BytesIO()
        savemat(alone, {name: value}, long_field_names=True, oned_as="column", do_compression=True)
        data = alone.getvalue()
        self._stream.write(data if self._stream.tell() == 0 else data[_HEADER_BYTES:])


def _plain(arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Masks as 0 and 1: logical arrays inside structures are not read by every version."""
    return {name: storable(array) for name, array in arrays.items()}
