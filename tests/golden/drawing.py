"""Static SVG drawings of boxes and arrows for the documentation, which need no script and no network."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

BOX_PX = (124.0, 40.0)
PITCH_PX = (156.0, 112.0)
MARGIN_PX = (28.0, 36.0)

_STYLE = (
    "text{font:13px sans-serif;text-anchor:middle;fill:#1a1a1a}rect.box{fill:#eef3fa;stroke:#3b5b8c}"
    "path{fill:none;stroke:#555;stroke-width:1.2}rect.page{fill:#fff}"
)


def svg(boxes: Mapping[str, tuple[float, float]], arrows: Sequence[tuple[str, str]], title: str, bend: float = 0.14) -> str:
    """SVG text of labelled boxes and arrows between them.

    Args:
        boxes: column and row of each label; a label may have several lines.
        arrows: label of the first and of the second box of each arrow.
        title: description for screen readers.
        bend: deviation of an arrow from a straight line, as a fraction of its length; a curve keeps to the left of its direction,
            except for a long way back in a row, which lies above the row.
    """
    centres = {label: _centre(*place) for label, place in boxes.items()}
    width = max(x for x, _ in centres.values()) + BOX_PX[0] / 2 + MARGIN_PX[0]
    height = max(y for _, y in centres.values()) + BOX_PX[1] / 2 + MARGIN_PX[0]
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" role="img">',
        f"<title>{escape(title)}</title><style>{_STYLE}</style>",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0,0 L8,4 L0,8 Z" style="fill:#555;stroke:none"/></marker></defs>',
        '<rect class="page" width="100%" height="100%"/>',
    ]
    parts += [f'<path marker-end="url(#tip)" d="{_curve(centres[first], centres[second], bend)}"/>' for first, second in arrows]
    for label, (x, y) in centres.items():
        parts.append(
            f'<rect class="box" x="{x - BOX_PX[0] / 2:.0f}" y="{y - BOX_PX[1] / 2:.0f}" '
            f'width="{BOX_PX[0]:.0f}" height="{BOX_PX[1]:.0f}" rx="5"/>'
        )
        lines = label.split("\n")
        parts += [
            f'<text x="{x:.0f}" y="{y + 5 + 15 * (number - (len(lines) - 1) / 2):.0f}">{escape(line)}</text>'
            for number, line in enumerate(lines)
        ]
    return "\n".join([*parts, "</svg>", ""])


def _centre(column: float, row: float) -> tuple[float, float]:
    return MARGIN_PX[0] + BOX_PX[0] / 2 + column * PITCH_PX[0], MARGIN_PX[1] + BOX_PX[1] / 2 + row * PITCH_PX[1]


def _curve(first: tuple[float, float], second: tuple[float, float], bend: float) -> str:
    """Path from the edge of the first box to that of the second; a loop above the box if they are the same."""
    (x0, y0), (x1, y1) = first, second
    if first == second:
        top = y0 - BOX_PX[1] / 2
        return f"M{x0 - 20:.0f},{top:.0f} C{x0 - 40:.0f},{top - 42:.0f} {x0 + 40:.0f},{top - 42:.0f} {x0 + 20:.0f},{top:.0f}"
    control = (x0 + x1) / 2 + bend * (y1 - y0), (y0 + y1) / 2 - bend * (x1 - x0)
    if y0 == y1 and x0 - x1 > 1.5 * PITCH_PX[0]:  # a long way back lies above the row
        control = control[0], 2 * y0 - control[1]
    (ax, ay), (bx, by) = _edge(first, control), _edge(second, control)
    return f"M{ax:.0f},{ay:.0f} Q{control[0]:.0f},{control[1]:.0f} {bx:.0f},{by:.0f}"


def _edge(centre: tuple[float, float], target: tuple[float, float]) -> tuple[float, float]:
    """Intersection of a box with the line from its centre towards a target."""
    dx, dy = target[0] - centre[0], target[1] - centre[1]
    scale = min(BOX_PX[0] / 2 / abs(dx) if dx else math.inf, BOX_PX[1] / 2 / abs(dy) if dy else math.inf)
    return centre[0] + dx * scale, centre[1] + dy * scale
