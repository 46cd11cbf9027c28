"""What happens in the export folder, seen by somebody who looks all the time."""

from __future__ import annotations

import io
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import tifffile

from semlive_simulators.clockwork import BenchClock
from semlive_simulators.exporters.settings import Style, Vendor
from semlive_simulators.machine import Machine
from semlive_simulators.render import render_frame
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.sem import Exported, Sem

RATE = 10.0
PAPER = load_scenario("paper_x200")
SMALL = replace(PAPER, scan=replace(PAPER.scan, width_px=128, height_px=110, frame_time_s=2.2, gap_s=0.8), first_scan_s=0.2)


@pytest.fixture(scope="module", autouse=True)
def warm_kernels() -> None:
    render_frame(SMALL)


@dataclass(frozen=True, slots=True)
class Look:
    """A file as it was for a moment, experiment seconds since the start."""

    time_s: float
    name: str
    size: int
    data: bytes


def watched(folder: Path, scenario: Scenario, frames: int) -> tuple[list[Look], list[Exported], int]:
    """Every look at the folder until so many frames are exported, these frames, and when the clock began."""
    clock = BenchClock(RATE, lambda _: None)
    exported: list[Exported] = []
    failures: list[BaseException] = []
    sem = Sem(scenario, clock, Machine(scenario, clock.start_ns), folder, False, exported.append, failures.append)
    looks: list[Look] = []
    clock.begin()
    sem.start()
    deadline = time.monotonic() + 20
    while len(exported) < frames and time.monotonic() < deadline:
        for path in sorted(folder.iterdir()):
            try:
                data = path.read_bytes()
            except FileNotFoundError:  # renamed since
                continue
            looks.append(Look((clock.now_ns() - clock.start_ns) * 1e-9, path.name, len(data), data))
        time.sleep(0.002)
    sem.stop()
    assert failures == []
    assert len(exported) >= frames
    return looks, exported, clock.start_ns


def small(**export: object) -> Scenario:
    return replace(SMALL, export=replace(PAPER.export, databar_rows=20, **export))  # type: ignore[arg-type]


def sizes(looks: Iterable[Look], name: str) -> list[int]:
    return [look.size for look in looks if look.name == name]


def test_a_slow_share_shows_every_stage_of_a_file(tmp_path: Path) -> None:
    looks, _, _ = watched(tmp_path, small(delay_s=0.1, duration_s=2.4, chunks=5), 1)
    seen = [*sizes(looks, "x200_0001.tif"), (tmp_path / "x200_0001.tif").stat().st_size]
    assert len(set(seen)) == 5
    assert seen == sorted(seen)
    times = [look.time_s for look in looks if look.name == "x200_0001.tif" and look.size < max(seen)]
    assert times[-1] - times[0] > 1.2


def test_a_temporary_name_is_gone_when_the_final_one_is_there(tmp_path: Path) -> None:
    looks, _, _ = watched(tmp_path, small(style=Style.RENAME, duration_s=1.0), 1)
    assert len(set(sizes(looks, "x200_0001.tif.tmp"))) > 2
    assert len(set(sizes(looks, "x200_0001.tif"))) <= 1
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith("x200_0001")] == ["x200_0001.tif"]


def test_a_preallocated_file_has_its_size_before_its_rows(tmp_path: Path) -> None:
    looks, _, _ = watched(tmp_path, small(style=Style.PREALLOCATE, vendor=Vendor.ZEISS, duration_s=2.0, delay_s=0.1), 1)
    data = [look.data for look in looks if look.name == "x200_0001.tif"]
    assert {len(one) for one in data} - {0} == {(tmp_path / "x200_0001.tif").stat().st_size}
    middle = next(one for one in data if one and any(one[:100]) and not any(one[-1000:]))
    assert not tifffile.imread(io.BytesIO(middle))[-20:].any()  # decodes without error, rows missing
    assert tifffile.imread(tmp_path / "x200_0001.tif")[-20:].any()


def test_a_sidecar_comes_late(tmp_path: Path) -> None:
    looks, exported, start_ns = watched(tmp_path, small(vendor=Vendor.JEOL, delay_s=0.1, duration_s=0.3, sidecar_delay_s=1.5), 1)
    alone = {look.time_s for look in looks if look.name.endswith(".tif")} - {look.time_s for look in looks if look.name.endswith(".txt")}
    assert max(alone) - min(alone) > 0.8
    image, sidecar = tmp_path / "x200_0001.tif", tmp_path / "x200_0001.txt"
    assert b"$CM_FULL_SIZE 128 110" in sidecar.read_bytes()
    later_ns = sidecar.stat().st_mtime_ns - image.stat().st_mtime_ns
    assert abs(later_ns - 1_500_000_000) < 1_000
    end_ns = exported[0].start_time_ns + 2_200_000_000
    assert abs(image.stat().st_mtime_ns - end_ns - 400_000_000) < 1_000
    assert start_ns < end_ns


def test_a_counter_that_begins_again_overwrites(tmp_path: Path) -> None:
    _, exported, _ = watched(tmp_path, small(counter_restarts_after=2, delay_s=0.1, duration_s=0.3), 4)
    names = [item.file for item in exported[:4]]
    assert names == ["x200_0001.tif", "x200_0002.tif", "x200_0001.tif", "x200_0002.tif"]
    assert {path.name for path in tmp_path.iterdir()} == {"x200_0001.tif", "x200_0002.tif"}
    latest = {item.file: item.image for item in exported}
    for name, image in latest.items():
        assert np.array_equal(tifffile.imread(tmp_path / name)[:110], image)


def test_the_clock_of_the_microscope_is_wrong(tmp_path: Path) -> None:
    _, exported, _ = watched(tmp_path, small(clock_offset_s=-3600.0, delay_s=0.1, duration_s=0.3), 1)
    with tifffile.TiffFile(tmp_path / "x200_0001.tif") as tif:
        told = tif.fei_metadata
    assert told is not None
    said = datetime.strptime(told["PrivateFei"]["TimeOfCreation"], "%d.%m.%Y %H:%M:%S").replace(tzinfo=UTC)
    end_s = exported[0].start_time_ns * 1e-9 + 2.2
    assert abs(end_s - 3600.0 - said.timestamp()) < 1.01
    assert abs((tmp_path / "x200_0001.tif").stat().st_mtime - end_s) < 1.0  # the share's clock is right
