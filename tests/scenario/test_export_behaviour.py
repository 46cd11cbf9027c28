"""What happens in the export folder, seen by somebody who looks all the time."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import tifffile

from semlive.data.clock import Clock
from semlive_simulators.bench_clock import BenchClock
from semlive_simulators.exporters.settings import Collision, Vendor, WriteStyle
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.microscope.sem import Exported, Sem
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.machine import LoadTrain

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


def watched(
    folder: Path,
    scenario: Scenario,
    frames: int,
    published: Callable[[Clock], None] = lambda _: None,
    caught: Callable[[list[Look]], object] = lambda _: True,
) -> tuple[list[Look], list[Exported], int]:
    """Every look at the folder until so many frames are exported and what is looked for was seen, these frames, and when the clock began.

    What lasts for a tenth of a second may pass while a busy computer does not look: it comes again with the next frame.
    """
    clock = BenchClock(RATE, published)
    exported: list[Exported] = []
    failures: list[BaseException] = []
    sem = Sem(scenario, clock, LoadTrain(scenario, clock.start_ns), folder, False, exported.append, failures.append)
    looks: list[Look] = []
    clock.begin()
    sem.start()
    deadline = time.monotonic() + 100
    while (len(exported) < frames or not caught(looks)) and time.monotonic() < deadline:
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
    assert caught(looks)
    return looks, exported, clock.start_ns


def small(**export: object) -> Scenario:
    return replace(SMALL, export=replace(PAPER.export, databar_rows=20, **export))  # type: ignore[arg-type]


def sizes(looks: Iterable[Look], name: str) -> list[int]:
    return [look.size for look in looks if look.name == name]


def names(looks: Iterable[Look], suffix: str = ".tif") -> list[str]:
    return sorted({look.name for look in looks if look.name.endswith(suffix)})


def test_a_slow_share_shows_every_stage_of_a_file(tmp_path: Path) -> None:
    def stages(looks: list[Look]) -> list[str]:
        """Files that were seen at every fifth of their size."""
        whole = max((look.size for look in looks), default=0)
        # A look may also fall into a write, which the kernel does page by page.
        required = {round(part * whole / 5) for part in range(1, 6)}
        return [name for name in names(looks) if whole and required <= set(sizes(looks, name))]

    looks, _, _ = watched(tmp_path, small(delay_s=0.1, duration_s=8.0, chunks=5), 1, caught=stages)
    name = stages(looks)[0]
    observed = sizes(looks, name)
    assert observed == sorted(observed)
    assert observed[-1] == (tmp_path / name).stat().st_size
    times = [look.time_s for look in looks if look.name == name and look.size < max(observed)]
    assert times[-1] - times[0] > 4.0


def test_a_temporary_name_is_gone_when_the_final_one_is_there(tmp_path: Path) -> None:
    def growing(looks: list[Look]) -> bool:
        return any(len(set(sizes(looks, name))) > 2 for name in names(looks, ".tmp"))

    looks, _, _ = watched(tmp_path, small(style=WriteStyle.RENAME, duration_s=3.0), 1, caught=growing)
    assert all(len(set(sizes(looks, name))) == 1 for name in names(looks))
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith("x200_0001")] == ["x200_0001.tif"]


def test_a_preallocated_file_has_its_size_before_its_rows(tmp_path: Path) -> None:
    def half(looks: list[Look]) -> list[Look]:
        return [look for look in looks if any(look.data[:100]) and not any(look.data[-1000:])]

    looks, exported, _ = watched(
        tmp_path, small(style=WriteStyle.PREALLOCATE, vendor=Vendor.ZEISS, duration_s=2.0, delay_s=0.1), 1, caught=half
    )
    middle = half(looks)[0]
    # A look may also fall into the write that preallocates, which the kernel does page by page: then nothing is in it yet.
    assert {look.size for look in looks if look.name == middle.name and any(look.data)} == {(tmp_path / middle.name).stat().st_size}
    assert not tifffile.imread(io.BytesIO(middle.data))[-20:].any()  # decodes without error, rows missing
    assert tifffile.imread(tmp_path / exported[0].file)[-20:].any()


def test_a_sidecar_comes_late(tmp_path: Path) -> None:
    scenario = small(vendor=Vendor.JEOL, delay_s=0.1, duration_s=0.3, sidecar_delay_s=1.5)

    def alone(looks: list[Look]) -> bool:
        """An image was seen without its text for most of the time for which it has none."""
        for name in names(looks):
            texts = [look.time_s for look in looks if look.name == name.replace(".tif", ".txt")]
            before = [look.time_s for look in looks if look.name == name and (not texts or look.time_s < texts[0])]
            if texts and before and before[-1] - before[0] > 0.8:
                return True
        return False

    _, exported, start_ns = watched(tmp_path, scenario, 1, caught=alone)
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
        reported = tif.fei_metadata
    assert reported is not None
    printed = datetime.strptime(reported["PrivateFei"]["TimeOfCreation"], "%d.%m.%Y %H:%M:%S").replace(tzinfo=UTC)
    end_s = exported[0].start_time_ns * 1e-9 + 2.2
    assert abs(end_s - 3600.0 - printed.timestamp()) < 1.01
    assert abs((tmp_path / "x200_0001.tif").stat().st_mtime - end_s) < 1.0  # the share's clock is right


def test_a_late_sidecar_does_not_hold_up_the_next_image(tmp_path: Path) -> None:
    looks, exported, _ = watched(tmp_path, small(vendor=Vendor.JEOL, delay_s=0.1, duration_s=0.3, sidecar_delay_s=7.0), 2)
    first_observed = {look.name: look.time_s for look in reversed(looks)}
    assert first_observed["x200_0003.tif"] < first_observed["x200_0001.txt"] + 0.5  # frames are 3 s apart, the sidecar is 7.4 s late
    assert first_observed["x200_0002.tif"] < first_observed["x200_0001.txt"] - 2.0
    assert [item.file for item in exported[:2]] == ["x200_0001.tif", "x200_0002.tif"]
    for item in exported[:2]:
        written_ns = (tmp_path / item.file).with_suffix(".txt").stat().st_mtime_ns
        assert abs(written_ns - item.end_time_ns - 7_400_000_000) < 1_000


def test_a_share_slower_than_the_scans_delays_files_but_neither_scans_nor_clock(tmp_path: Path) -> None:
    scenario = small(delay_s=0.1, duration_s=4.9, chunks=5)  # frames are 3 s apart
    # A computer that hangs for 0.1 s stretches the clock as well, but not every time; a share that held up scans would.
    for attempt in range(5):
        clocks: list[Clock] = []
        folder = tmp_path / str(attempt)
        folder.mkdir()
        looks, exported, start_ns = watched(folder, scenario, 3, clocks.append)
        if len(clocks) == 1:
            break
    assert len(clocks) == 1  # published when it began, never stretched
    starts_s = [(item.start_time_ns - start_ns) * 1e-9 for item in exported[:3]]
    assert starts_s == pytest.approx([0.2, 3.2, 6.2])
    written_s = [((folder / item.file).stat().st_mtime_ns - start_ns) * 1e-9 for item in exported[:3]]
    assert written_s == pytest.approx([2.4 + 5.0, 2.4 + 10.0, 2.4 + 15.0], abs=1e-3)
    assert {look.name for look in looks} >= {"x200_0001.tif", "x200_0002.tif", "x200_0003.tif"}
    for item in exported[:3]:
        assert np.array_equal(tifffile.imread(folder / item.file)[:110], item.image)


@pytest.mark.parametrize(("style", "left"), [(WriteStyle.DIRECT, 0.6), (WriteStyle.RENAME, 0.6), (WriteStyle.PREALLOCATE, 1.0)])
def test_a_file_is_never_finished_and_the_next_one_is(tmp_path: Path, style: WriteStyle, left: float) -> None:
    scenario = small(vendor=Vendor.JEOL, style=style, never_finished=(1,), delay_s=0.1, duration_s=0.5, chunks=4)
    looks, exported, _ = watched(tmp_path, scenario, 2)
    assert [item.frame for item in exported[:2]] == [0, 2]
    working = "x200_0002.tif.tmp" if style is WriteStyle.RENAME else "x200_0002.tif"
    sizes_observed = sizes(looks, working)
    whole = (tmp_path / "x200_0001.tif").stat().st_size
    assert max(sizes_observed) == pytest.approx(left * whole, rel=0.02)
    assert (tmp_path / working).stat().st_size == max(sizes_observed)
    assert not (tmp_path / "x200_0002.txt").exists()
    assert (tmp_path / "x200_0003.txt").exists()


def test_a_name_that_is_taken_gets_a_number(tmp_path: Path) -> None:
    (tmp_path / "x200_0002.tif").write_bytes(b"somebody's")
    scenario = small(counter_restarts_after=2, collision=Collision.NUMBER, delay_s=0.1, duration_s=0.3)
    _, exported, _ = watched(tmp_path, scenario, 4)
    names = [item.file for item in exported[:4]]
    assert names == ["x200_0001.tif", "x200_0002_1.tif", "x200_0001_1.tif", "x200_0002_2.tif"]
    assert (tmp_path / "x200_0002.tif").read_bytes() == b"somebody's"
