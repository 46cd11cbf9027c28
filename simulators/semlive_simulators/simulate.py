"""A complete experiment without a daemon: the protocol of the scenario in experiment time, as fast as frames are rendered.

Writes ``export/`` as the instrument does, ``truth.json`` as the bench does, and ``frames.csv`` with the purpose of each frame, and with
the strain gage if the experiment reads one. Transient states (partly written files, late sidecars) are simulated by the bench only. A
counter that restarts is too, because files would be overwritten before they are read.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.settings import WriteStyle
from semlive_simulators.exporters.writing import plan_files, write_file
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import BadScenario, Scenario, load_scenario
from semlive_simulators.specimen.protocol_player import START_NS, ProtocolPlayer, ScannedFrame
from semlive_simulators.truth import TruthRecorder, frame_truth

COLUMNS = (
    "frame", "pair", "phase", "start_s", "dwell_s", "row_time_s", "width", "height", "integrations", "load_n", "shift_x_px", "shift_y_px",
)  # fmt: skip
GAGE_COLUMN = "gage_strain"


def simulate(scenario: Scenario, out: Path, frames: frozenset[int] | None) -> Iterator[tuple[ScannedFrame, int]]:
    """Play the experiment and write its files.

    Args:
        scenario: the simulated experiment.
        out: an empty or new folder.
        frames: numbers of the frames to render and to write; None is all. The experiment does not depend on it.

    Yields:
        Each frame that was written, and the total number of frames.

    Raises:
        BadScenario: if the experiment cannot be played.
        OSError: if the folder cannot be written.
    """
    export = replace(scenario.export, style=WriteStyle.DIRECT, counter_restarts_after=0, never_finished=())
    player = ProtocolPlayer(scenario)
    beyond = sorted(frame for frame in frames or () if frame >= player.frames)
    if beyond:
        raise BadScenario(f"there is no frame {beyond[0]}; scenario {scenario.name} has frames 0-{player.frames - 1}")
    total = player.frames if frames is None else len(frames)
    (out / "export").mkdir(parents=True, exist_ok=True)
    truth, rows, column = TruthRecorder(scenario, START_NS), [], scenario.column()
    for shot in player.play():
        if frames is not None and shot.frame not in frames:
            continue
        name = export.file_name(shot.frame)
        image = render_frame(scenario, shot.start_s, shot.window.motion, shot.frame, column)
        stamp_ns = scenario.stamp_ns(shot.end_ns, START_NS)
        facts = ImageMetadata(
            scenario.scan,
            stamp_ns,
            shot.encoder_x_um,
            shot.encoder_y_um,
            shot.frame,
            name,
            shot.beam_x_um,
            shot.beam_y_um,
            scenario.row_start_s,
        )
        for plan in plan_files(export.encode(image, facts), name, export):
            write_file(plan, out / "export", shot.end_ns, lambda _: contextlib.nullcontext())
        truth.add_frame(
            frame_truth(scenario, name, shot.start_ns, shot.start_s, shot.window.motion, shot.window.force_mean_n, shot.window.moving),
            shot.window.motion.history,
        )
        rows.append(_row(shot, facts, scenario.gaged))
        yield shot, total
    (out / "truth.json").write_bytes(truth.encode(player.time_ns, 0, 0.0))
    (out / "frames.csv").write_bytes(_table(rows, scenario.gaged))


def _row(shot: ScannedFrame, facts: ImageMetadata, gaged: bool) -> list[object]:
    scan = facts.scan
    load = "" if shot.stop.load_n is None else f"{shot.load_mean_n:.3f}"
    timing = [f"{shot.start_s:.6f}", repr(scan.dwell_time_s), repr(facts.line_time_s)]
    size = [scan.width_px, scan.height_px, facts.frames_integrated]
    strain = ["" if math.isnan(shot.gage_strain) else f"{shot.gage_strain:.9f}"] if gaged else []
    return [shot.frame, shot.frame // 2, shot.stop.phase, *timing, *size, load, *shot.stop.shift_px, *strain]


def _table(rows: list[list[object]], gaged: bool) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*COLUMNS, GAGE_COLUMN) if gaged else COLUMNS)
    writer.writerows(rows)
    return text.getvalue().encode()


def frame_numbers(text: str) -> frozenset[int]:
    """Numbers from ``0-3,8``.

    Raises:
        ValueError: if the text is not such a list.
    """
    numbers: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.partition("-")
        low, high = int(first), int(last if dash else first)
        if not 0 <= low <= high < 1_000_000:
            raise ValueError(text)
        numbers.update(range(low, high + 1))
    return frozenset(numbers)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="frames", description="Frames and truth of a simulated experiment.")
    parser.add_argument("--scenario", default="paper_x200", help="name of a scenario, or a path ending in .yaml")
    parser.add_argument("--out", type=Path, required=True, help="folder for export/, truth.json and frames.csv; new or empty")
    parser.add_argument("--seed", type=int, default=None, help="replaces the seed of the scenario")
    parser.add_argument("--frames", default=None, help="only these frames, counted from 0: 0-3,8")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Write frames and truth; exit code 0, 2 for bad input. Prints ``FRAME DONE TOTAL`` for each frame on standard output."""
    options = _parser().parse_args(argv)
    out: Path = options.out.resolve()
    try:
        frames = None if options.frames is None else frame_numbers(options.frames)
    except ValueError:
        return _refused(f"--frames {options.frames}: is no list of frame numbers; write it as 0-3,8")
    try:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            return _refused(f"{options.out}: is not empty; give a new folder")
        scenario = load_scenario(options.scenario, options.seed)
        for done, (shot, total) in enumerate(simulate(scenario, out, frames), 1):
            sys.stdout.write(f"{shot.frame} {done} {total}\n")
            sys.stdout.flush()
    except BadScenario as error:
        return _refused(str(error))
    except OSError as error:
        return _refused(f"{options.out}: {error.strerror}; give a folder that can be written")
    return 0


def _refused(reason: str) -> int:
    sys.stderr.write(f"simulate: {reason}\n")
    return 2


if __name__ == "__main__":
    sys.exit(main())
