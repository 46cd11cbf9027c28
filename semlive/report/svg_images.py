"""Smaller SVG files without loss: images of at most 256 colours become palettes, and an image that is drawn several times is stored once.

Matplotlib writes every map as RGBA, although a colour map has 256 colours, and the SEM image again under each map of a sheet.
"""

from __future__ import annotations

import base64
import io
import re

import numpy as np
from PIL import Image

_IMAGE = re.compile(r'<image (?P<attributes>[^>]*?)xlink:href="data:image/png;base64,(?P<data>[^"]*)"(?P<more>[^>]*?)/>', re.DOTALL)
_EDGES = re.compile(r'\b(?:width|height)="[^"]*"')
_ID = re.compile(r'\bid="[^"]*"')
_MAX_COLOURS = 256


def compact_svg(svg: str) -> str:
    """Return an SVG of matplotlib that is drawn equally, with smaller images.

    Args:
        svg: text with images as embedded PNG.
    """
    stored: dict[tuple[str, str], str] = {}

    def smaller(found: re.Match[str]) -> str:
        attributes = found["attributes"] + found["more"]
        edges = " ".join(_EDGES.findall(attributes))
        place = _EDGES.sub("", _ID.sub("", attributes))
        key = (found["data"], edges)
        use = f'<use xlink:href="#shared{len(stored)}" {place}/>'
        if key in stored:
            return f'<use xlink:href="#{stored[key]}" {place}/>'
        stored[key] = f"shared{len(stored)}"
        data = base64.b64encode(palette_png(base64.b64decode(found["data"]))).decode("ascii")
        return f'<defs><image id="{stored[key]}" {edges} xlink:href="data:image/png;base64,{data}"/></defs>{use}'

    return _IMAGE.sub(smaller, svg)


def palette_png(png: bytes) -> bytes:
    """Return a PNG with the same pixels, as a palette if it has at most 256 colours with their opacities; the smaller of both files.

    Args:
        png: RGB or RGBA, 8 bit.
    """
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGBA"))
    packed = np.ascontiguousarray(pixels).view(np.uint32)[..., 0]
    # The colour of invisible pixels is not drawn.
    packed = np.where(pixels[..., 3] == 0, np.uint32(0), packed)
    colours, indices = np.unique(packed, return_inverse=True)
    if len(colours) > _MAX_COLOURS:
        return png
    table = np.ascontiguousarray(colours).view(np.uint8).reshape(-1, 4)
    image = Image.fromarray(indices.reshape(packed.shape).astype(np.uint8), mode="P")
    image.putpalette(table[:, :3].tobytes())
    stream = io.BytesIO()
    opaque = bool((table[:, 3] == 255).all())
    image.save(stream, format="png", optimize=True, **({} if opaque else {"transparency": table[:, 3].tobytes()}))
    return min(png, stream.getvalue(), key=len)
