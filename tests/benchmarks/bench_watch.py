"""Ten thousand files dropped into export folders in every pattern of arrival; each accepted or refused once, for the right reason.

    python tests/benchmarks/bench_watch.py --files 10000 --seed 1

Real files in real folders under a clock that is moved by hand: one folder of FEI, Zeiss, TESCAN and plain files, one of JEOL and Hitachi
files with their texts beside them, each with files from before the run. A pattern is a generator that does to its file what a microscope, a
share or a hand does, a step a second, and says what the watch must make of it. One JSON line is printed; the code is 1 if any verdict
is wrong, missing or given twice.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Generator
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
    """What the watch must say of one name."""

    pattern: str
    data: bytes | None = None
    sidecar: bytes | None = None
    refusals: tuple[str, ...] = ()


@dataclass
class Scene:
    """A watched folder, what goes on in it and what was said about it."""

    path: Path
    aside: Path
    clock: HandClock
    vendors: tuple[Vendor, ...]
    rng: np.random.Generator
    vendor: str | None = None
    watched_at: Path | None = None
    """Where the watch sees the folder, if not at `path`: on another computer's side of a share."""
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
        """Say what must come of a name."""
        self.expected[name] = Expected(pattern, data, sidecar, refusals)

    def write(self, name: str, data: bytes, mtime_ns: int | None = None) -> None:
        """Put bytes under a name, as of now."""
        path = self.path / name
        path.write_bytes(data)
        when = self.clock.ns if mtime_ns is None else mtime_ns
        os.utime(path, ns=(when, when))

    def text_of(self, name: str, made: EncodedFrame) -> None:
        """The text beside it, if its vendor writes one."""
        if made.sidecar is not None:
            self.write(Path(name).with_suffix(".txt").name, made.sidecar)


PAPER = load_scenario("paper_x200").scan
SCAN = dataclasses.replace(PAPER, width_px=32, height_px=24, frame_time_s=24 * 0.0045)


def wait(seconds: int) -> Steps:
    """Nothing happens for a while."""
    for _ in range(seconds):
        yield


def direct(scene: Scene) -> Steps:
    """Written at once."""
    name, made = scene.product()
    scene.expect("direct", name, made.image, sidecar=made.sidecar)
    scene.text_of(name, made)
    scene.write(name, made.image)
    yield


def slowly(scene: Scene) -> Steps:
    """Grows, with pauses longer than the watch asks for."""
    name, made = scene.product()
    scene.expect("slowly", name, made.image, sidecar=made.sidecar)
    pieces = int(scene.rng.integers(3, 7))
    for part in range(1, pieces + 1):
        scene.write(name, made.image[: len(made.image) * part // pieces])
        yield from wait(int(scene.rng.integers(1, 6)))
    scene.text_of(name, made)


def renamed(scene: Scene) -> Steps:
    """Written under a temporary name, then renamed."""
    name, made = scene.product()
    scene.expect("renamed", name, made.image, sidecar=made.sidecar)
    scene.text_of(name, made)
    scene.write(f"{name}.tmp", made.image[: len(made.image) // 2])
    yield from wait(4)
    scene.write(f"{name}.tmp", made.image)
    (scene.path / f"{name}.tmp").rename(scene.path / name)


def moved_in(scene: Scene) -> Steps:
    """Written elsewhere and moved in, older than it arrives."""
    name, made = scene.product()
    scene.expect("moved in", name, made.image, sidecar=made.sidecar)
    scene.text_of(name, made)
    scene.write(f"{scene.aside.name}-{name}.tmp", made.image, scene.clock.ns - 10**12)
    (scene.path / f"{scene.aside.name}-{name}.tmp").rename(scene.path / name)
    yield


def preallocated(scene: Scene) -> Steps:
    """Has its size at once, zeros first, and stands still in the middle for longer than the watch asks for."""
    name, made = scene.product()
    scene.expect("preallocated", name, made.image, sidecar=made.sidecar)
    scene.text_of(name, made)
    size = len(made.image)
    scene.write(name, bytes(size))
    yield from wait(4)
    scene.write(name, made.image[: size // 2].ljust(size, b"\0"))
    yield from wait(6)
    scene.write(name, made.image)


def touched(scene: Scene) -> Steps:
    """Taken, then touched by a scanner for viruses: the same bytes, another change time."""
    name, made = scene.product()
    scene.expect("touched", name, made.image, sidecar=made.sidecar)
    scene.text_of(name, made)
    scene.write(name, made.image)
    yield from wait(8)
    (scene.path / name).chmod(0o640)


def given_another_name(scene: Scene) -> Steps:
    """Renamed by hand before it was taken."""
    name, made = scene.product()
    other = f"x_{name[2:7]}9" + Path(name).suffix
    scene.expect("given another name", other, made.image, sidecar=made.sidecar)
    if made.sidecar is not None:
        scene.write(Path(other).with_suffix(".txt").name, made.sidecar)
    scene.write(name, made.image)
    yield
    (scene.path / name).rename(scene.path / other)


def late_text(scene: Scene) -> Steps:
    """Its text comes seconds after the image."""
    name, made = scene.product()
    scene.expect("late text", name, made.image, sidecar=made.sidecar)
    scene.write(name, made.image)
    yield from wait(int(scene.rng.integers(3, SIDECAR_S - 8)))
    if made.sidecar is not None:
        scene.write(Path(name).with_suffix(".txt").name, made.sidecar[: len(made.sidecar) // 2])
        yield
        scene.text_of(name, made)


def no_text(scene: Scene) -> Steps:
    """Its text never comes."""
    name, made = scene.product()
    scene.expect("no text", name, None, "never got the text file")
    scene.write(name, made.image)
    yield


def foreign_text(scene: Scene) -> Steps:
    """The text beside it is that of another image."""
    name, made = scene.product()
    _, other = scene.product(scale=2)
    scene.expect("text of another image", name, None, "its header describes another image")
    scene.write(name, made.image)
    scene.text_of(name, other)
    yield


def cut(scene: Scene) -> Steps:
    """Never finished, sometimes but for its last bytes."""
    name, made = scene.product(Vendor.FEI if scene.vendor is None else None)
    end = len(made.image) - 5 if scene.rng.random() < 0.3 else int(scene.rng.integers(10, len(made.image) - 5))
    scene.expect("cut", name, None, "never became complete")
    scene.text_of(name, made)
    scene.write(name, made.image[:end])
    yield


def zeros(scene: Scene) -> Steps:
    """Preallocated and half filled for good."""
    name, made = scene.product(Vendor.ZEISS)
    scene.expect("zeros", name, None, "rows are zero")
    size = len(made.image)
    scene.write(name, made.image[: size - 32 * int(scene.rng.integers(2, 20))].ljust(size, b"\0"))
    yield


def empty(scene: Scene) -> Steps:
    """Nothing is ever written into it, or something that is no image."""
    name, _ = scene.product(scene.vendors[0])
    scene.expect("no image", name, None, "it is neither TIFF nor PNG")
    scene.write(name, b"" if scene.rng.random() < 0.5 else b"hello, world")
    if scene.vendor is not None:
        scene.write(Path(name).with_suffix(".txt").name, b"$CM_FORMAT JEOL-SEM\r\n")
    yield


def copied(scene: Scene) -> Steps:
    """The same bytes under a second name: a frozen image saved twice."""
    name, made = scene.product()
    again, _ = scene.product(Vendor.PNG if name.endswith("png") else scene.vendors[0])
    scene.expect("original", name, made.image, sidecar=made.sidecar)
    scene.expect("copied", again, None, f"holds the same bytes as {name}")
    scene.text_of(name, made)
    scene.write(name, made.image)
    yield from wait(6)
    scene.text_of(again, made)
    scene.write(again, made.image)


def overwritten(scene: Scene) -> Steps:
    """Taken, then another image under its name, in pieces."""
    name, made = scene.product()
    _, other = scene.product()
    scene.expect("overwritten", name, made.image, "was overwritten", sidecar=made.sidecar)
    scene.text_of(name, made)
    scene.write(name, made.image)
    yield from wait(8)
    for part in (1, 2, 3):
        scene.write(name, other.image[: len(other.image) * part // 3])
        yield


def overwritten_unseen(scene: Scene) -> Steps:
    """Taken, then changed with its size and modification time as before."""
    name, made = scene.product()
    path = scene.path / name
    scene.expect("overwritten with its time restored", name, made.image, "was overwritten", sidecar=made.sidecar)
    scene.text_of(name, made)
    scene.write(name, made.image)
    yield from wait(8)
    before = path.stat()
    while path.stat().st_ctime_ns == before.st_ctime_ns:
        scene.write(name, made.image[:-9] + b"different", before.st_mtime_ns)
    yield


def deleted(scene: Scene) -> Steps:
    """Gone before it was whole."""
    name, made = scene.product()
    scene.expect("deleted", name, None, "disappeared before it was complete")
    scene.write(name, made.image[: len(made.image) // 3])
    yield from wait(3)
    (scene.path / name).unlink()


def giant(scene: Scene) -> Steps:
    """Larger than may be."""
    name, made = scene.product()
    scene.expect("too large", name, None, f"is larger than {MAX_BYTES} bytes")
    scene.text_of(name, made)
    scene.write(name, made.image + bytes(MAX_BYTES))
    yield


def bystander(scene: Scene) -> Steps:
    """Not looked at: other names, hidden files, files in the making, a folder called like an image."""
    scene.made += 1
    for name in (f"n{scene.made}.doc", f".x_{scene.made}.tif", f"x_{scene.made}.tif.part"):
        scene.write(name, b"II*\0")
    (scene.path / f"d{scene.made}.tif").mkdir()
    yield


COMMON = (direct, direct, slowly, renamed, moved_in, preallocated, touched, given_another_name, cut, empty, copied, overwritten)
COMMON += (overwritten_unseen, deleted, giant, bystander)
SCENES: tuple[tuple[str | None, tuple[Vendor, ...], tuple[Callable[[Scene], Steps], ...]], ...] = (
    (None, (Vendor.FEI, Vendor.ZEISS, Vendor.TESCAN, Vendor.TIFF, Vendor.PNG), (*COMMON, zeros)),
    ("jeol", (Vendor.JEOL,), (*COMMON, late_text, no_text, foreign_text)),
    ("hitachi", (Vendor.HITACHI,), (*COMMON, late_text, no_text, foreign_text)),
)


def play(scene: Scene, patterns: tuple[Callable[[Scene], Steps], ...], files: int, at_once: int) -> float:
    """Drop so many files, some each second, while the share goes away now and then; gives the processor time of the watch, s."""
    running: list[Steps] = []
    spent_s, second, quiet_until = 0.0, 0, 0
    while len(scene.expected) < files or running or second < quiet_until:
        if len(scene.expected) < files:
            quiet_until = second + SIDECAR_S + 2 * GIVE_UP_S
            running += [patterns[int(scene.rng.integers(len(patterns)))](scene) for _ in range(at_once)]
        running = [one for one in running if next(one, running) is None]
        away = second % 97 == 50
        if away:
            scene.path.rename(scene.aside)
        started = time.process_time()
        scene.folder.poll()
        spent_s += time.process_time() - started
        if away:
            scene.aside.rename(scene.path)
        scene.clock.ns += 10**9
        second += 1
    return spent_s


def wrong_verdicts(scene: Scene) -> list[str]:
    """Every name whose verdict is not the one expected, given once."""
    wrong: list[str] = []
    taken = {name: [one for one in scene.files if one.name == name] for name in {one.name for one in scene.files}}
    said = {name: [one.reason for one in scene.refused if one.name == name] for name in {one.name for one in scene.refused}}
    for name in scene.expected.keys() | taken.keys() | said.keys():
        want = scene.expected.get(name, Expected("nobody's"))
        came, refusals = taken.get(name, []), said.get(name, [])
        whole = [(one.data, one.sidecar) for one in came] == ([] if want.data is None else [(want.data, want.sidecar)])
        told = len(refusals) == len(want.refusals) and all(part in one for part, one in zip(want.refusals, refusals, strict=False))
        if not (whole and told):
            wrong.append(f"{name} ({want.pattern}): taken {len(came)} times, refused {refusals}")
    if [one.index for one in scene.files] != list(range(len(scene.files))):
        wrong.append("exports are not numbered in order")
    return wrong


def measure(files: int, seed: int, folder: Path, at_once: int = 15) -> dict[str, object]:
    """The whole campaign: so many files over all scenes, and as many from before the run in the first."""
    told: dict[str, object] = {"files": 0, "seed": seed}
    counts: Counter[str] = Counter()
    wrong: list[str] = []
    spent_s, taken, refused = 0.0, 0, 0
    for number, (vendor, vendors, patterns) in enumerate(SCENES):
        path = folder / f"export{number}"
        path.mkdir()
        scene = Scene(path, folder / f"away{number}", HandClock(), vendors, np.random.default_rng((seed, number)), vendor)
        for old in range(files // 10):
            (path / f"old_{old}.tif").write_bytes(b"from before")
        scene.open()
        spent_s += play(scene, patterns, files // 2 if number == 0 else files // 4, at_once)
        wrong += wrong_verdicts(scene)
        counts.update(one.pattern for one in scene.expected.values())
        taken, refused = taken + len(scene.files), refused + len(scene.refused)
    told |= {"files": counts.total(), "taken": taken, "refused": refused, "wrong": len(wrong), "first_wrong": wrong[:5]}
    return told | {"by_pattern": dict(sorted(counts.items())), "processor_ms_per_file": round(1e3 * spent_s / counts.total(), 2)}


def main() -> int:
    """Run the campaign that the arguments ask for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        told = measure(arguments.files, arguments.seed, Path(folder))
    sys.stdout.write(json.dumps(told) + "\n")
    return 1 if told["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
