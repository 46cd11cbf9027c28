"""Export of a log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from semlive.errors import BadInput
from semlive.report.export.archive.deposit import Deposit
from semlive.report.export.archive.nexus_writer import NexusWriter
from semlive.report.export.archive.provenance import export_provenance
from semlive.report.export.archive.ro_crate_writer import RoCrateWriter
from semlive.report.export.csv_writer import CsvWriter
from semlive.report.export.fields import Format, RunMetadata, Writer
from semlive.report.export.hdf5_writer import Hdf5Writer
from semlive.report.export.mat_writer import MatWriter
from semlive.report.export.png_writer import PngWriter
from semlive.report.export.vtk_writer import VtkWriter, VtuWriter
from semlive.service.analysis.result_json import result_json
from semlive.service.config.overrides import as_keys
from semlive.service.log.files import log_name
from semlive.service.log.pairs import first_run, load_series
from semlive.service.replay.replay import ReplayCallbacks, ReplayRequest, ReplayResult, Source, replay, require_calibration

WRITERS: dict[Format, Callable[[Path], Writer]] = {
    Format.HDF5: Hdf5Writer,
    Format.CSV: CsvWriter,
    Format.MAT: MatWriter,
    Format.VTK: VtkWriter,
    Format.VTU: VtuWriter,
    Format.PNG: PngWriter,
    Format.NEXUS: NexusWriter,
    Format.RO_CRATE: RoCrateWriter,
}
ONE_FILE = frozenset((Format.HDF5, Format.MAT, Format.NEXUS))
"""Formats that write one file; the others write a folder."""
DESCRIBED = frozenset((Format.NEXUS, Format.RO_CRATE))
"""Formats that archive a run: they contain its provenance and the description of a deposit."""


def export_log(
    request: ReplayRequest,
    kind: Format,
    out: Path,
    progress: Callable[[str, int, int], None] | None = None,
    by: Callable[[ReplayRequest, ReplayCallbacks | None], ReplayResult] = replay,
    deposit: Deposit | None = None,
) -> ReplayResult:
    """Write a log's corrected fields, one frame in memory at a time.

    Args:
        request: the log; without a source its disparity maps are used.
        kind: format.
        out: file (hdf5, mat, nexus) or folder (all others).
        progress: called with the name of the task, the finished part and the total.
        by: name of the replaying program.
        deposit: description of a deposit, for formats that archive a run.

    Raises:
        BadInput: the log cannot be read, its calibration is refused, or `out` cannot be written.
    """
    request = request if request.source is not None else replace(request, source=Source.DISPARITY)
    try:
        writer = WRITERS[kind](out)
        complete = False
        try:
            done = by(request, ReplayCallbacks(progress, None, writer.write_frame, point_sigma=True))
            require_calibration(request.log, done)
            metadata = run_metadata(request.log, done)
            if kind in DESCRIBED:
                provenance = export_provenance(request.log, deposit or Deposit(), done.settings.scan)
                metadata = replace(metadata, provenance=provenance)
            writer.write_metadata(metadata)
            complete = True
        finally:
            writer.close(complete)
    except OSError as error:
        raise BadInput(f"{out}: cannot be written ({error.strerror or error}); give a writable path.") from error
    return done


def run_metadata(log: Path, done: ReplayResult) -> RunMetadata:
    """Metadata of a replayed log: result, settings, configuration and load."""
    result = result_json(done.result, done.settings)
    return RunMetadata(log_name(log), done.result, result, as_keys(done.settings), first_run(log).config, load_series(log))
