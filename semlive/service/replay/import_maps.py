"""Import of disparity maps of another DIC program as a log (format 1, see docs/how-to/import.md)."""

from __future__ import annotations

import contextlib
import re
import socket
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from semlive.data.disparity import DisparityMap
from semlive.data.experiment import Step
from semlive.data.frame import FrameInfo, FrameOrigin
from semlive.data.grid import Grid
from semlive.data.loading import FrameLoad
from semlive.data.pair import PairDecision
from semlive.data.scan import Provenance, RowClock, ScanTiming, Sourced
from semlive.data.settings import SpecimenSettings
from semlive.errors import BadInput, BadLog
from semlive.formats.log import conversions as values
from semlive.formats.log.maps import encode_map
from semlive.formats.log.messages import DIC_MAP, DicMessage, RunMessage
from semlive.formats.log.writer import LogWriter
from semlive.formats.metadata.row_clock import read_row_clock
from semlive.formats.tables.disparity_grid import check_inside, grid_of, map_on
from semlive.formats.tables.disparity_table import DisparityTable, read_disparity_table
from semlive.formats.tables.frame_table import FrameRow, read_frame_table
from semlive.inputs.files import read_regular
from semlive.service.log.files import PARTIAL_SUFFIX, messages
from semlive.service.log.settings import ImportConfig, ImportNoise, ImportSection, is_imported
from semlive.service.replay.import_noise import noise_of
from semlive.service.runtime.versions import versions

FRAMES = "frames.csv"
ZERO_NS = 946_684_800_000_000_000
"""Origin of the time axis of the tables, which have no date: 2000-01-01, UTC ns."""
_CLOCK_SUFFIXES = (".csv", ".txt", ".npy", ".npz")
_NAME = re.compile(r"disparity_(\d{1,9})_(\d{1,9})\.(?:csv|txt|dat)", re.IGNORECASE)
NOISE_MAPS = 6  # maps within pairs from which the correlation of the noise is estimated
_MAX_BYTES = 10**9
"""Largest size of a file; a map with the largest number of points, ten million, is smaller."""
_DAMAGED = "cannot be {0} ({1}); check the path and its permissions."


@dataclass(frozen=True, slots=True)
class ImportRequest:
    """Request of an import.

    Attributes:
        folder: folder with `frames.csv` and the maps.
        log: the log to write.
        specimen: properties of the specimen.
        dialect: file format of the maps; None detects it from the header of each file.
        subset_px: edge of the subset of the DIC program, px; None takes the value in the files, or else an estimate from their noise.
        hold_s: time from the end of the step to the start of each pair, s; None if it is unknown.
    """

    folder: Path
    log: Path
    specimen: SpecimenSettings = field(default_factory=SpecimenSettings)
    dialect: str | None = None
    subset_px: int | None = None
    hold_s: float | None = None


@dataclass(frozen=True, slots=True)
class ImportSummary:
    """Result of an import.

    Attributes:
        pairs: number of pairs.
        maps: number of maps.
        grid: grid of all maps.
        engines: file formats of the maps.
        skipped: names of maps that belong to no pair of `frames.csv`.
        noise: correlation of the noise over points, and its source.
    """

    pairs: int
    maps: int
    grid: Grid
    engines: tuple[str, ...]
    skipped: tuple[str, ...]
    noise: ImportNoise


def import_folder(request: ImportRequest, progress: Callable[[int, int], None] | None = None) -> ImportSummary:
    """Write a log from a folder, one pair in memory at a time.

    Args:
        request: folder, log and properties of the specimen.
        progress: callback with the number of completed pairs and the total.

    Raises:
        BadInput: a file of the folder is wrong; the message contains file, line, column and advice. No log is written.
    """
    if not request.folder.is_dir():
        raise BadInput(f"{request.folder}: no such folder; give the folder with {FRAMES} and the maps.")
    rows = read_frame_table(_read(request.folder / FRAMES), FRAMES)
    files = _map_files(request.folder)
    used = [frames for pair in rows[::2] for frames in _maps_of(pair.pair, files)]
    skipped = tuple(sorted(files[frames].name for frames in files.keys() - set(used)))
    _check_overwriting(request.log)
    part = request.log.with_name(request.log.name + PARTIAL_SUFFIX)
    try:
        with part.open("wb") as stream:
            writer = LogWriter(stream)
            done = _write(request, rows, files, writer, progress)
            writer.finish()
        part.replace(request.log)
    except OSError as error:
        raise BadInput(f"{request.log}: {_DAMAGED.format('written', error.strerror)}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
    grid, engines, noise = done
    return ImportSummary(len(rows) // 2, len(used), grid, engines, skipped, noise)


def _write(
    request: ImportRequest,
    rows: tuple[FrameRow, ...],
    files: dict[tuple[int, int], Path],
    writer: LogWriter,
    progress: Callable[[int, int], None] | None,
) -> tuple[Grid, tuple[str, ...], ImportNoise]:
    first, grid, noise, engines = rows[0], None, None, ()
    for pair, (row, next_row) in enumerate(zip(rows[::2], rows[1::2], strict=True)):
        decision = _decision(row, next_row, (_clock(request.folder, row), _clock(request.folder, next_row)))
        end_ns = decision.second.end_time_ns
        for reference, current in _maps_of(row.pair, files):
            path = files[reference, current]
            table = read_disparity_table(_read(path), path.name, request.dialect)
            check_inside(table, first.width, first.height)
            if grid is None:
                noise = noise_of(request.subset_px, table, lambda: _within_pairs(request, rows, files))
                grid = grid_of(table, noise.subset_px)
                engines = (table.dialect.name,)
                writer.write("/run", _run(request, engines, first, noise), _ns(first.start_s), _ns(first.start_s))
            if reference == row.frame:
                writer.write("/pair", values.pair_message(decision), end_ns, end_ns)
            disparity = map_on(table, grid, reference, current)
            if not disparity.valid.any():
                raise BadInput(f"{path.name}: no point is valid; export a map with valid points, or leave pair {row.pair} out.")
            writer.write(DIC_MAP, encode_map(disparity), end_ns, end_ns, current)
            writer.write("/dic/summary", _summary(disparity), end_ns, end_ns)
        writer.flush()
        if progress is not None:
            progress(pair + 1, len(rows) // 2)
    assert grid is not None  # there is a pair, and it has a map
    assert noise is not None
    return grid, engines, noise


def _within_pairs(request: ImportRequest, rows: tuple[FrameRow, ...], files: dict[tuple[int, int], Path]) -> Iterator[DisparityTable]:
    """Maps within pairs, spread over the run."""
    first = rows[::2]
    for at in sorted({round(place) for place in np.linspace(0, len(first) - 1, NOISE_MAPS)}):
        path = files[first[at].frame, first[at].frame + 1]
        table = read_disparity_table(_read(path), path.name, request.dialect)
        check_inside(table, first[at].width, first[at].height)
        yield table


def _maps_of(pair: int, files: dict[tuple[int, int], Path]) -> list[tuple[int, int]]:
    """Return the frames of the maps of a pair: within the pair, and from frame 0.

    Raises:
        BadInput: a required map is missing.
    """
    first, second = 2 * pair, 2 * pair + 1
    required = [(first, second)] if pair == 0 else [(first, second), (0, first)]
    for reference, current in required:
        if (reference, current) not in files:
            what = "the drift within the pair" if reference == first else "the motion of the pair"
            name = f"disparity_{reference}_{current}.csv"
            raise BadInput(f"{name}: is missing, but it determines {what}; add it, or take the frames of pair {pair} out of {FRAMES}.")
    return [*required, *([(0, second)] if pair and (0, second) in files else [])]


def _map_files(folder: Path) -> dict[tuple[int, int], Path]:
    maps: dict[tuple[int, int], Path] = {}
    for path in sorted(folder.iterdir()):
        name = _NAME.fullmatch(path.name)
        if name is not None:
            frames = int(name[1]), int(name[2])
            if frames in maps:
                raise BadInput(f"{path.name}: is the same map as {maps[frames].name}; keep one of them.")
            maps[frames] = path
    return maps


def _read(path: Path) -> bytes:
    try:
        return read_regular(path, _MAX_BYTES)
    except FileNotFoundError:
        raise BadInput(f"{path}: is missing; write it as docs/how-to/import.md shows.") from None
    except OSError as error:
        raise BadInput(f"{path}: {_DAMAGED.format('read', error.strerror)}") from error


def _check_overwriting(log: Path) -> None:
    """Check that an existing log is an import; only such a log may be overwritten."""
    if not log.exists():
        return
    try:
        first = next(iter(messages(log)), None)
        is_import = first is not None and first.topic == "/run" and is_imported(RunMessage.model_validate_json(first.payload).config)
    except (BadLog, ValueError):
        is_import = False
    if not is_import or not log.is_file():
        raise BadInput(f"{log}: exists and was not written by an import; give another name with -o.")


def _run(request: ImportRequest, engines: tuple[str, ...], first: FrameRow, noise: ImportNoise) -> RunMessage:
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", request.folder.resolve().name).strip("-.") or "imported"
    section = ImportSection(folder=str(request.folder), engines=engines, noise=noise, hold_s=request.hold_s)
    config = ImportConfig(imported=section, specimen=request.specimen)
    return RunMessage(
        run=name,
        started_time_ns=_ns(first.start_s),
        host=socket.gethostname(),
        versions=versions(),
        config=config.model_dump(mode="json"),
    )


def _clock(folder: Path, row: FrameRow) -> RowClock | None:
    """Measured times of a frame from ``clock_<frame>`` in the folder; None without such a file."""
    paths = [path for suffix in _CLOCK_SUFFIXES if (path := folder / f"clock_{row.frame}{suffix}").is_file()]
    if len(paths) > 1:
        raise BadInput(f"{paths[1].name}: is a second clock of frame {row.frame}; keep one.")
    return read_row_clock(_read(paths[0]), paths[0].name, row.width, row.height) if paths else None


def _decision(first: FrameRow, second: FrameRow, clocks: tuple[RowClock | None, RowClock | None]) -> PairDecision:
    step = Step(first.pair, first.phase, (0.0, 0.0), first.shift_px or (0.0, 0.0), first.load_n)
    loads = (_load(first), _load(second))
    return PairDecision(
        first.pair,
        step,
        _info(first, clocks[0]),
        _info(second, clocks[1]),
        None if loads[0] is None or loads[1] is None else (loads[0], loads[1]),
    )


def _load(row: FrameRow) -> FrameLoad | None:
    load_n, gage = row.load_n, row.gage_strain
    return None if load_n is None else FrameLoad(load_n, load_n, load_n, 0.0, gage, None if gage is None else 0.0)


def _info(row: FrameRow, clock: RowClock | None) -> FrameInfo:
    source = Provenance.CONFIG
    timing = ScanTiming(
        Sourced(row.dwell_s, source),
        Sourced(row.row_time_s, source),
        Sourced(row.height * row.row_time_s, Provenance.DERIVED),
        Sourced(row.integrations, source),
        clock=clock,
    )
    start = Sourced(_ns(row.start_s), source)
    pixel_m = Sourced(0.0, Provenance.UNKNOWN) if row.pixel_nm is None else Sourced(1e-9 * row.pixel_nm, source)
    return FrameInfo(row.frame, f"frame_{row.frame}", FrameOrigin.IMPORTED.value, row.width, row.height, 0, timing, start, 0.0, pixel_m)


def _summary(disparity: DisparityMap) -> DicMessage:
    valid = disparity.valid
    return DicMessage(
        reference=disparity.reference,
        current=disparity.current,
        points=valid.size,
        converged=int(valid.sum()),
        mean_u_px=float(disparity.u_px[valid].mean()),
        mean_v_px=float(disparity.v_px[valid].mean()),
        noise_px=float(disparity.sigma_u_px[valid].mean()),
        wall_s=0.0,
    )


def _ns(time_s: float) -> int:
    return ZERO_NS + round(time_s * 1e9)


def as_json(request: ImportRequest, done: ImportSummary) -> dict[str, object]:
    """Return the object that `semlive import --json` prints."""
    return {
        "log": str(request.log),
        "pairs": done.pairs,
        "maps": done.maps,
        "grid": asdict(done.grid),
        "from": list(done.engines),
        "left_out": list(done.skipped),
        "noise": done.noise.model_dump(mode="json"),
        "hold_s": request.hold_s,
    }
