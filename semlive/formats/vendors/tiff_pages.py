"""Which image of a TIFF file is the frame: copies of reduced size are not, and of several frames the user chooses one.

NewSubfileType: TIFF 6.0 specification, page 36 (bit 0: reduced copy of another image of the file, bit 2: transparency mask);
SubfileType: page 40 (2: reduced copy). Programs that write a preview often leave both out, so an image of the same proportions and at
most half the width is taken for a copy, too. ImageJ writes stacks of more than 4 GB behind one directory and states their number in
the description (imagej.net, file format of TIFF hyperstacks).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from semlive.errors import BadImage
from semlive.formats.vendors.image_size import check_size
from semlive.formats.vendors.tiff import Directory, Tag, directories, sub_directories

_COPY_OR_MASK = 0b101
_SAME_PROPORTIONS = 0.02
_TURNS = {
    2: "mirrored",
    3: "turned by 180 degrees",
    4: "mirrored upside down",
    5: "mirrored and turned by 90 degrees",
    6: "turned by 90 degrees",
    7: "mirrored and turned by 270 degrees",
    8: "turned by 270 degrees",
}


class SeveralFrames(BadImage):
    """A file with several images, of which none was chosen."""


@dataclass(frozen=True, slots=True)
class Page:
    """The image of a TIFF file that is read.

    Attributes:
        index: place in the file, from 0.
        directory: its directory.
        first: the directory of the first image, which has the header of the vendor if the image has none.
        width_px: columns.
        rows: stored rows.
        notes: other images of the file, and an orientation that is not applied; one sentence each.
    """

    index: int
    directory: Directory
    first: Directory
    width_px: int
    rows: int
    notes: tuple[str, ...]


def find_page(data: bytes, name: str, number: int | None = None) -> Page:
    """Return the image that is the frame.

    Args:
        data: bytes of the file.
        name: file name, for messages.
        number: the image chosen by the user, from 1; None if there is only one frame.

    Raises:
        SeveralFrames: the file has several frames and `number` is None.
        BadImage: no directory can be read, the size is not plausible, or there is no image of this number.
    """
    found = directories(data, name)
    index = _index(data, name, found, number) if len(found) > 1 or number is not None else 0
    directory = found[index]
    if len(found) == 1:
        _refuse_stack(data, name, directory)
    width, rows = _size(data, directory)
    _refuse_larger_part(data, name, directory, (width, rows))
    check_size(name, width, rows, max(directory.integer(data, Tag.SAMPLES_PER_PIXEL, 1), 1))
    others = tuple(f"its {_described(data, found, at)} is not used." for at in range(len(found)) if at != index)
    turn = _TURNS.get(directory.integer(data, Tag.ORIENTATION, 1)) if Tag.ORIENTATION in directory.tags else None
    note = (f"its Orientation tag states an image {turn}; the rows are used as stored, in the order of the scan.",) if turn else ()
    return Page(index, directory, found[0], width, rows, others + note)


def _index(data: bytes, name: str, found: list[Directory], number: int | None) -> int:
    """Return the place of the frame among several images."""
    if number is not None:
        if not 1 <= number <= len(found):
            raise BadImage(f"{name}: has {len(found)} images, not an image {number}; correct sem.profile.page or --page.")
        return number - 1
    frames = [at for at in range(len(found)) if not _is_marked_copy(data, found[at])] or list(range(len(found)))
    largest = max((_size(data, found[at]) for at in frames), key=lambda size: size[0] * size[1])
    frames = [at for at in frames if not _is_small_copy(_size(data, found[at]), largest)]
    if len(frames) > 1:
        listed = ", ".join(_described(data, found, at) for at in range(len(found)))
        raise SeveralFrames(f"{name}: contains several images ({listed}); export single frames, or choose with sem.profile.page or --page.")
    return frames[0]


def _described(data: bytes, found: list[Directory], at: int) -> str:
    width, rows = _size(data, found[at])
    return f"image {at + 1} of {len(found)} ({width} x {rows} px{', a copy' if _is_marked_copy(data, found[at]) else ''})"


def _size(data: bytes, directory: Directory) -> tuple[int, int]:
    return directory.integer(data, Tag.WIDTH, 0), directory.integer(data, Tag.HEIGHT, 0)


def _is_marked_copy(data: bytes, directory: Directory) -> bool:
    old = directory.integer(data, Tag.OLD_SUBFILE_TYPE, 1) if Tag.OLD_SUBFILE_TYPE in directory.tags else 1
    return bool(directory.integer(data, Tag.SUBFILE_TYPE, 0) & _COPY_OR_MASK) or old == 2


def _is_small_copy(size: tuple[int, int], largest: tuple[int, int]) -> bool:
    (width, rows), (full_width, full_rows) = size, largest
    half = 0 < 2 * width <= full_width + 1 and 0 < 2 * rows <= full_rows + 1
    return half and abs(width * full_rows - rows * full_width) <= _SAME_PROPORTIONS * width * full_rows


def _refuse_larger_part(data: bytes, name: str, directory: Directory, size: tuple[int, int]) -> None:
    """Refuse an image that contains a larger one (SubIFDs, as in DNG): it is a thumbnail, and only images of the main list are read."""
    for part in sub_directories(data, directory):
        (width, rows), (part_width, part_rows) = size, _size(data, part)
        if part_width * part_rows > width * rows:
            problem = f"is a thumbnail of {width} x {rows} px with an image of {part_width} x {part_rows} px below it (SubIFDs)"
            raise BadImage(f"{name}: {problem}; export a plain TIFF.")


def _refuse_stack(data: bytes, name: str, directory: Directory) -> None:
    if Tag.DESCRIPTION not in directory.tags:
        return
    text = (directory.text(data, Tag.DESCRIPTION) or "")[:2000]
    stack = re.search(r"^images=(\d{1,9})$", text, re.MULTILINE) if text.startswith("ImageJ=") else None
    if stack is not None and int(stack[1]) > 1:
        raise BadImage(f"{name}: is an ImageJ stack of {stack[1]} images with one directory; save the images one by one.")
