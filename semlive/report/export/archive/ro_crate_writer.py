"""RO-Crate of a run: a folder with log, corrected fields and results, described by ``ro-crate-metadata.json``.

Specifications: https://w3id.org/ro/crate/1.1 and, for the actions, https://w3id.org/ro/wfrun/process/0.5.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from semlive.data.results import FrameResult
from semlive.report.export.archive.nexus_writer import NexusWriter
from semlive.report.export.archive.provenance import HashedFile, hashed
from semlive.report.export.archive.ro_crate_entities import FIELDS_FILE, METADATA_FILE, crate
from semlive.report.export.csv_writer import write_json_files
from semlive.report.export.fields import RunMetadata

_LOG_FOLDER = "log"


class RoCrateWriter:
    """A folder with ``log/``, ``fields.nxs``, ``result.json``, ``settings.json``, ``configuration.json`` and their description."""

    def __init__(self, out: Path) -> None:
        self._out = out
        out.mkdir(parents=True, exist_ok=True)
        self._nexus = NexusWriter(out / FIELDS_FILE)

    def write_frame(self, frame: FrameResult) -> None:
        """Append one frame to the fields."""
        self._nexus.write_frame(frame)

    def write_metadata(self, metadata: RunMetadata) -> None:
        """Write fields and results, copy the log, and describe all files."""
        self._nexus.write_metadata(metadata)
        self._nexus.close(True)
        write_json_files(self._out, metadata)
        names = [FIELDS_FILE, "result.json", "settings.json", "configuration.json", *self._copied_log(metadata)]
        files = [_inside(hashed(self._out / name), name) for name in names]
        content = json.dumps(crate(metadata, files), indent=1, ensure_ascii=False)
        (self._out / METADATA_FILE).write_text(content + "\n", encoding="utf-8")

    def close(self, complete: bool) -> None:
        """Remove incomplete fields."""
        if not complete:
            self._nexus.close(False)

    def _copied_log(self, metadata: RunMetadata) -> list[str]:
        """Copy the files of the log; returns their names in the crate."""
        assert metadata.provenance is not None  # checked by the writer of the fields
        (self._out / _LOG_FOLDER).mkdir(exist_ok=True)
        names = []
        for file in metadata.provenance.log:
            assert file.path is not None  # files of the log have one
            names.append(f"{_LOG_FOLDER}/{file.name}")
            shutil.copyfile(file.path, self._out / names[-1])
        return names


def _inside(file: HashedFile, name: str) -> HashedFile:
    """Return a file with its name relative to the crate."""
    return HashedFile(file.path, name, file.size, file.sha256)
