"""Patterns of arrival: what a microscope, a share or a hand does to a file, a step a second, and what the watch must make of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from semlive_simulators.exporters.settings import Vendor

from .hostile import HOSTILE
from .scene import MAX_BYTES, SIDECAR_S, Scene, Steps, wait


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
    """Has its size at once, zeros first, and does not change in the middle for longer than the watch requires."""
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
    """The text next to it is that of another image."""
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
    """Preallocated and half filled permanently."""
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
    """Gone before it was complete."""
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
    (None, (Vendor.FEI, Vendor.ZEISS, Vendor.TESCAN, Vendor.TIFF, Vendor.PNG), (*COMMON, *HOSTILE, zeros)),
    ("jeol", (Vendor.JEOL,), (*COMMON, late_text, no_text, foreign_text)),
    ("hitachi", (Vendor.HITACHI,), (*COMMON, late_text, no_text, foreign_text)),
)
