"""Import of disparity maps of another DIC program as a log (format 1, see docs/how-to/import.md)."""

from __future__ import annotations

import contextlib
import re
import socket
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from semlive.data.disparity import DisparityMap
from semlive.data.experiment import Step
from semlive.data.frame import FrameInfo, FrameOrigin
from semlive.data.grid import Grid
from semlive.data.loading import FrameLoad
from semlive.data.pair import PairDecision
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import SpecimenSettings
from semlive.errors import BadInput, BadLog
from semlive.formats.log import conversions as values
from semlive.formats.log.maps import encode_map
from semlive.formats.log.messages import DIC_MAP, DicMessage, RunMessage
from semlive.formats.log.writer import LogWriter
from semlive.formats.tables.disparity_grid import check_inside, grid_of, map_on
from semlive.formats.tables.disparity_table import read_disparity_table
from semlive.formats.tables.frame_table import FrameRow, read_frame_table
from semlive.inputs.files import read_regular
from semlive.service.log.files import PARTIAL_SUFFIX, messages
from semlive.service.log.settings import ImportConfig, ImportSection, is_imported
from semlive.service.runtime.versions import versions

FRAMES = "frames.csv"
ZERO_NS = 946_684_800_000_000_000
"""Begin of the user's time axis, which has no date: 2000-01-01, UTC ns."""
_NAME = re.compile(r"disparity_(\d{1,9})_(\d{1,9})\.(?:csv|txt|dat)", re.IGNORECASE)
_MOST_BYTES = 10**9
"""Ten million points, the most that a map may have, take less."""
_DAMAGED = "cannot be {0} ({1}); check the path and its permissions."


@dataclass(frozen=True, slots=True)
class ImportRequest:
    """Request of an import.

    Attributes:
        folder: folder with `frames.csv` and the maps.
        log: the log to write.
        specimen: properties of the specimen.
        dialect: file format of the maps; None detects it from the header of each file.
        subset_px: edge of the subset of the DIC program, px; None takes the value in the files, or 0 without one.
    """

    folder: Path
    log: Path
    specimen: SpecimenSettings = field(default_factory=SpecimenSettings)
    dialect: str | None = None
    subset_px: int | None = None


@dataclass(frozen=True, slots=True)
class ImportSummary:
    """Result of an import.

    Attributes:
        pairs: number of pairs.
        maps: number of maps.
        grid: grid of all maps.
        engines: file formats of the maps.
        skipped: names of maps that belong to no pair of `frames.csv`.
    """

    pairs: int
    maps: int
    grid: Grid
    engines: tuple[str, ...]
    skipped: tuple[str, ...]


def import_folder(asked: ImportRequest, progress: Callable[[int, int], None] | None = None) -> ImportSummary:
    """Write a log from a folder, one pair in memory at a time.

    Args:
        asked: what is asked for.
        progress: callback with the number of completed pairs and the total.

    Raises:
        BadInput: something in the folder is wrong: file, line, column and what to do. No log is left behind.
    """
    if not asked.folder.is_dir():
        raise BadInput(f"{asked.folder}: no such folder; give the folder with {FRAMES} and the maps.")
    rows = read_frame_table(_read(asked.folder / FRAMES), FRAMES)
    files = _map_files(asked.folder)
    wanted = [one for pair in rows[::2] for one in _maps_of(pair.pair, files)]
    left_out = tuple(sorted(files[one].name for one in files.keys() - set(wanted)))
    _check_overwriting(asked.log)
    part = asked.log.with_name(asked.log.name + PARTIAL_SUFFIX)
    try:
        with part.open("wb") as stream:
            writer = LogWriter(stream)
            done = _write(asked, rows, files, writer, progress)
            writer.finish()
        part.replace(asked.log)
    except OSError as error:
        raise BadInput(f"{asked.log}: {_DAMAGED.format('written', error.strerror)}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
    grid, engines = done
    return ImportSummary(len(rows) // 2, len(wanted), grid, engines, left_out)


def _write(
    asked: ImportRequest,
    rows: tuple[FrameRow, ...],
    files: dict[tuple[int, int], Path],
    writer: LogWriter,
    progress: Callable[[int, int], None] | None,
) -> tuple[Grid, tuple[str, ...]]:
    first, grid, engines = rows[0], None, ()
    for pair, (one, other) in enumerate(zip(rows[::2], rows[1::2], strict=True)):
        decision = _decision(one, other)
        end_ns = decision.second.end_time_ns
        for reference, current in _maps_of(one.pair, files):
            path = files[reference, current]
            table = read_disparity_table(_read(path), path.name, asked.dialect)
            check_inside(table, first.width, first.height)
            if grid is None:
                grid = grid_of(table, table.subset_px if asked.subset_px is None else asked.subset_px)
                engines = (table.dialect.name,)
                writer.write("/run", _run(asked, engines, first), _ns(first.start_s), _ns(first.start_s))
            if reference == one.frame:
                writer.write("/pair", values.pair_message(decision), end_ns, end_ns)
            disparity = map_on(table, grid, reference, current)
            if not disparity.valid.any():
                raise BadInput(f"{path.name}: no point is valid; export a map that has some, or leave pair {one.pair} out.")
            writer.write(DIC_MAP, encode_map(disparity), end_ns, end_ns, current)
            writer.write("/dic/summary", _summary(disparity), end_ns, end_ns)
        writer.flush()
        if progress is not None:
            progress(pair + 1, len(rows) // 2)
    assert grid is not None  # there is a pair, and it has a map
    return grid, engines


def _maps_of(pair: int, files: dict[tuple[int, int], Path]) -> list[tuple[int, int]]:
    """The maps of a pair: within it, and from frame 0.

    Raises:
        BadInput: one that is needed is not there.
    """
    first, second = 2 * pair, 2 * pair + 1
    wanted = [(first, second)] if pair == 0 else [(first, second), (0, first)]
    for reference, current in wanted:
        if (reference, current) not in files:
            what = "the drift within the pair" if reference == first else "the motion of the pair"
            name = f"disparity_{reference}_{current}.csv"
            raise BadInput(f"{name}: is missing, it tells {what}; add it, or take the frames of pair {pair} out of {FRAMES}.")
    return [*wanted, *([(0, second)] if pair and (0, second) in files else [])]


def _map_files(folder: Path) -> dict[tuple[int, int], Path]:
    found: dict[tuple[int, int], Path] = {}
    for path in sorted(folder.iterdir()):
        name = _NAME.fullmatch(path.name)
        if name is not None:
            frames = int(name[1]), int(name[2])
            if frames in found:
                raise BadInput(f"{path.name}: is the same map as {found[frames].name}; keep one of them.")
            found[frames] = path
    return found


def _read(path: Path) -> bytes:
    try:
        return read_regular(path, _MOST_BYTES)
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
        ours = first is not None and first.topic == "/run" and is_imported(RunMessage.model_validate_json(first.payload).config)
    except (BadLog, ValueError):
        ours = False
    if not ours or not log.is_file():
        raise BadInput(f"{log}: exists and was not written by an import; give another name with -o.")


def _run(asked: ImportRequest, engines: tuple[str, ...], first: FrameRow) -> RunMessage:
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", asked.folder.resolve().name).strip("-.") or "imported"
    config = ImportConfig(imported=ImportSection(folder=str(asked.folder), engines=engines), specimen=asked.specimen)
    return RunMessage(
        run=name,
        started_time_ns=_ns(first.start_s),
        host=socket.gethostname(),
        versions=versions(),
        config=config.model_dump(mode="json"),
    )


def _decision(one: FrameRow, other: FrameRow) -> PairDecision:
    step = Step(one.pair, one.phase, (0.0, 0.0), one.shift_px or (0.0, 0.0), one.load_n)
    loads = (_load(one), _load(other))
    return PairDecision(one.pair, step, _info(one), _info(other), None if loads[0] is None or loads[1] is None else (loads[0], loads[1]))


def _load(row: FrameRow) -> FrameLoad | None:
    load_n, gage = row.load_n, row.gage_strain
    return None if load_n is None else FrameLoad(load_n, load_n, load_n, 0.0, gage, None if gage is None else 0.0)


def _info(row: FrameRow) -> FrameInfo:
    told = Provenance.CONFIG
    timing = ScanTiming(
        Sourced(row.dwell_s, told),
        Sourced(row.row_time_s, told),
        Sourced(row.height * row.row_time_s, Provenance.DERIVED),
        Sourced(row.integrations, told),
    )
    start, unknown = Sourced(_ns(row.start_s), told), Sourced(0.0, Provenance.UNKNOWN)
    return FrameInfo(row.frame, f"frame_{row.frame}", FrameOrigin.IMPORTED.value, row.width, row.height, 0, timing, start, 0.0, unknown)


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


def as_json(asked: ImportRequest, done: ImportSummary) -> dict[str, object]:
    """The object that `semlive import --json` prints."""
    return {
        "log": str(asked.log),
        "pairs": done.pairs,
        "maps": done.maps,
        "grid": asdict(done.grid),
        "from": list(done.engines),
        "left_out": list(done.skipped),
    }
