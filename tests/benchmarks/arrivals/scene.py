"""A watched folder under a clock that is moved by hand, the events in it, and the verdicts on its files."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from semlive.data.frame import ExportedFile
from semlive.service.watch.export_folder import ExportFolder
from semlive.service.watch.watch_settings import RejectedFile, WatchSettings
from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.scenario import load_scenario

STABLE_S, GIVE_UP_S, SIDECAR_S, MAX_BYTES = 2, 20, 30, 60_000
Steps = Generator[None, None, None]


@dataclass
class HandClock:
    """Wall and experiment time, moved by hand."""

    ns: int = 1_772_439_825_000_000_000

    def now_ns(self) -> int:
        return self.ns

    def mono_ns(self) -> int:
        return self.ns


@dataclass
class Expected:
    """The required verdict of the watch on one name."""

    pattern: str
    data: bytes | None = None
    sidecar: bytes | None = None
    refusals: tuple[str, ...] = ()


@dataclass
class Scene:
    """A watched folder, the events in it and the reports about it."""

    path: Path
    aside: Path
    clock: HandClock
    vendors: tuple[Vendor, ...]
    rng: np.random.Generator
    vendor: str | None = None
    watched_at: Path | None = None
    """Path of the folder for the watch, if not at `path`: on another computer's side of a share."""
    expected: dict[str, Expected] = field(default_factory=dict)
    files: list[ExportedFile] = field(default_factory=list)
    refused: list[RejectedFile] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)
    folder: ExportFolder = field(init=False)
    made: int = 0

    def open(self) -> None:
        """Begin to watch."""
        settings = WatchSettings(
            self.watched_at or self.path,
            stable_for_s=STABLE_S,
            give_up_after_s=GIVE_UP_S,
            sidecar_timeout_s=SIDECAR_S,
            max_bytes=MAX_BYTES,
            vendor=self.vendor,
        )
        self.folder = ExportFolder(settings, self.clock, self.files.append, self.refused.append, self.troubles.append, self.notices.append)
        self.folder.open()

    def product(self, vendor: Vendor | None = None, scale: int = 1) -> tuple[str, EncodedFrame]:
        """A new file and its name."""
        vendor = vendor or self.vendors[int(self.rng.integers(len(self.vendors)))]
        self.made += 1
        name = f"x_{self.made:05d}" + (".png" if vendor is Vendor.PNG else ".tif")
        scan = dataclasses.replace(
            SCAN, width_px=SCAN.width_px * scale, height_px=SCAN.height_px * scale, frame_time_s=SCAN.frame_time_s * scale**2
        )
        image = self.rng.integers(1, 256, (scan.height_px, scan.width_px), dtype=np.uint8)
        facts = ImageMetadata(scan, self.clock.ns, 0.0, 0.0, self.made, name)
        return name, Export(WriteStyle.DIRECT, 0.0, 1.0, 1, 0, "x", vendor).encode(image, facts)

    def expect(self, pattern: str, name: str, data: bytes | None, *refusals: str, sidecar: bytes | None = None) -> None:
        """Register the expected verdict on a name."""
        self.expected[name] = Expected(pattern, data, sidecar, refusals)

    def write(self, name: str, data: bytes, mtime_ns: int | None = None) -> None:
        """Put bytes under a name, as of now."""
        path = self.path / name
        path.write_bytes(data)
        when = self.clock.ns if mtime_ns is None else mtime_ns
        os.utime(path, ns=(when, when))

    def text_of(self, name: str, made: EncodedFrame) -> None:
        """The text next to it, if its vendor writes one."""
        if made.sidecar is not None:
            self.write(Path(name).with_suffix(".txt").name, made.sidecar)


PAPER = load_scenario("paper_x200").scan
SCAN = dataclasses.replace(PAPER, width_px=32, height_px=24, frame_time_s=24 * 0.0045)


def wrong_verdicts(scene: Scene) -> list[str]:
    """Every name whose verdict is not the one expected, given once."""
    wrong: list[str] = []
    taken = {name: [one for one in scene.files if one.name == name] for name in {one.name for one in scene.files}}
    reasons = {name: [one.reason for one in scene.refused if one.name == name] for name in {one.name for one in scene.refused}}
    for name in scene.expected.keys() | taken.keys() | reasons.keys():
        want = scene.expected.get(name, Expected("nobody's"))
        came, refusals = taken.get(name, []), reasons.get(name, [])
        complete = [(one.data, one.sidecar) for one in came] == ([] if want.data is None else [(want.data, want.sidecar)])
        reported = len(refusals) == len(want.refusals) and all(part in one for part, one in zip(want.refusals, refusals, strict=False))
        if not (complete and reported):
            wrong.append(f"{name} ({want.pattern}): taken {len(came)} times, refused {refusals}")
    if [one.index for one in scene.files] != list(range(len(scene.files))):
        wrong.append("exports are not numbered in order")
    return wrong


def wait(seconds: int) -> Steps:
    """Nothing happens for a while."""
    for _ in range(seconds):
        yield
