"""Writers that make a file look complete before it is, for less time than the watch awaits files whose bytes prove nothing."""

from __future__ import annotations

from collections.abc import Callable

from semlive_simulators.exporters.settings import Vendor

from .scene import Scene, Steps, wait

_BLOCK_BYTES = 256
_POLLS = 2
"""Scans that find each state: enough for a proof by bytes, too few for one by time."""


def out_of_order(scene: Scene) -> Steps:
    """Has its size at once; blocks are written in any order, as a memory-mapped file is."""
    name, made = scene.product()
    scene.expect("out of order", name, made.image)
    content, blocks = bytearray(len(made.image)), range(0, len(made.image), _BLOCK_BYTES)
    order = list(scene.rng.permutation(len(blocks)))
    for share in range(0, len(order), max(1, len(order) // 4)):
        for block in order[share : share + max(1, len(order) // 4)]:
            at = blocks[block]
            content[at : at + _BLOCK_BYTES] = made.image[at : at + _BLOCK_BYTES]
        scene.write(name, bytes(content))
        yield from wait(_POLLS)


def last_rows_last(scene: Scene) -> Steps:
    """All of it is there but for two rows in the middle of the image."""
    name, made = scene.product(Vendor.ZEISS)
    scene.expect("a hole in the middle", name, made.image)
    size, row_bytes = len(made.image), 32
    at = size - int(scene.rng.integers(4, 20)) * row_bytes
    scene.write(name, made.image[:at] + bytes(2 * row_bytes) + made.image[at + 2 * row_bytes :])
    yield from wait(_POLLS)
    scene.write(name, made.image)


def header_later(scene: Scene) -> Steps:
    """A complete image first; the program then writes it again with its header."""
    image, made = scene.product(Vendor.TIFF)
    _, full = scene.product(Vendor.FEI)
    scene.expect("header later", image, full.image)
    scene.write(image, made.image)
    yield from wait(_POLLS)
    scene.write(image, full.image)


def checksum_later(scene: Scene) -> Steps:
    """A PNG of its final size; some of its pixels are those of an old file until the end."""
    name, made = scene.product(Vendor.PNG)
    scene.expect("checksum later", name, made.image)
    middle = len(made.image) // 2
    scene.write(name, made.image[:middle] + b"old pixels" + made.image[middle + 10 :])
    yield from wait(_POLLS)
    scene.write(name, made.image)


def times_restored(scene: Scene) -> Steps:
    """Grows while its modification time is set back after every write."""
    name, made = scene.product()
    scene.expect("times restored", name, made.image)
    when_ns = scene.clock.ns
    for part in (1, 2, 3):
        scene.write(name, made.image[: len(made.image) * part // 3], when_ns)
        yield from wait(_POLLS)


HOSTILE: tuple[Callable[[Scene], Steps], ...] = (out_of_order, last_rows_last, header_later, checksum_later, times_restored)
