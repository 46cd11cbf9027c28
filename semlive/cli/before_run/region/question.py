"""Question of `semlive init` for region and masks: the page in the browser, or four numbers in the terminal."""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import typer

from semlive.cli.before_run.region.drawing import Drawing, FrameSize, Region, default_region, mask_png, parse_region
from semlive.cli.before_run.region.server import RegionServer
from semlive.cli.shared.terminal import echo
from semlive.data.settings import DicSettings
from semlive.errors import BadInput
from semlive.formats.images.image_files import read_picture
from semlive.inputs.files import read_regular

_MAX_IMAGE_BYTES = 2**30


@dataclass(frozen=True, slots=True)
class RegionAnswer:
    """Region of interest of a test frame.

    Attributes:
        region_px: first and last subset centre.
        mask: PNG with 0 where the frame must not be used; None without masks.
    """

    region_px: Region
    mask: bytes | None = None


def region_answer(
    test_frame: Path,
    region: str | None,
    draw: bool | None,
    ask: bool,
    opened: Callable[[str], object] | None = None,
) -> RegionAnswer:
    """Return the region of interest for a test frame.

    Args:
        test_frame: image file of the microscope.
        region: region as text from the command line; None if it was not given.
        draw: whether to draw in the browser; None: a question decides.
        ask: whether the command may ask questions.
        opened: opens an address in a browser; None: the browser of the desktop.

    Raises:
        BadInput: the frame cannot be read, is smaller than a subset, or `region` is not in it.
    """
    try:
        image = read_picture(read_regular(test_frame, _MAX_IMAGE_BYTES), str(test_frame))
    except OSError as error:
        raise BadInput(f"{test_frame}: cannot be read ({error.strerror}); give an image file that exists") from error
    height, width = image.shape
    size = FrameSize(width, height, DicSettings().subset_px)
    start = default_region(size) if region is None else parse_region(region, size)
    if draw or (draw is None and ask and region is None and typer.confirm("Draw region and masks in the browser", default=True)):
        try:
            with RegionServer(image, size, start) as server:
                echo(f"draw on the test frame: {server.address} (Ctrl+C: enter the region here)", err=True)
                (opened or _open_in_browser)(server.address)
                return _drawn(server.answer(), start, size)
        except KeyboardInterrupt:
            echo("nothing was drawn", err=True)
    if ask and region is None:
        start = _typed(start, size)
    return RegionAnswer(start)


def _open_in_browser(address: str) -> None:
    """Open an address in the browser of the desktop; without a desktop nothing, because a text browser would take the terminal."""
    if sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(address)


def _drawn(drawing: Drawing | None, start: Region, size: FrameSize) -> RegionAnswer:
    if drawing is None:
        return RegionAnswer(start)
    return RegionAnswer(drawing.region_px, mask_png(drawing, size) if drawing.masks_px else None)


def _typed(start: Region, size: FrameSize) -> Region:
    """Ask for the region until it is valid."""
    while True:
        text = typer.prompt("Region of subset centres x0,y0,x1,y1, px", default=",".join(map(str, start)))
        try:
            return parse_region(text, size)
        except BadInput as error:
            echo(str(error), err=True)
