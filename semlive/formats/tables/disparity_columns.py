"""Columns of disparity maps: names in the spellings of several DIC programs, and the program that wrote a map."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from semlive.errors import BadInput
from semlive.formats.tables.disparity_marks import CORRELATION, FOUND_AT, INVALID, MARKS, SPELLINGS, TEXT_MARKS, UNKNOWN_SENSE, VALID
from semlive.inputs.text_table import Column, key_of

PIXELS = ("px", "pixel", "pixels", "pix", *(f"{unit}/frame" for unit in ("px", "pixel", "pixels", "pix")))
XYUV = ("x", "y", "u", "v")
_IN_PIXELS = (*XYUV, "sigma", "sigmau", "sigmav")
_SPELLINGS = {
    "{x}": "{x}image image{x} coordinates.image{x} coordinatesimage{x} coord{x} {x}coord {x}coordinate coordinate{x} pos{x} {x}pos"
    " position{x} {x}position {x}pic {x}ref {x}px {x}pixel pixel{x} {x}0 {x}koordinate koordinate{x} {x}koord {x}coordonnée {x}座標 座標{x}"
    " {x}坐标 坐标{x} {x}p p{x} {x}pix pix{x} {x}center center{x} {x}centre centre{x} {x}point point{x} grid{x} {line}",
    "{u}": "u{x} d{x} displacement{x} {x}displacement displacement{u} {u}displacement disp{x} {x}disp disp{u} {u}disp displacement.{x}"
    " displacement.{u} {along}displacement {along}displacement{u} disp.{along}displacement{u} displacement.{along}displacement{u}"
    " {u}ref {u}px {u}pixel delta{x} delta{u} δ{x} ∆{x} disp.{x} displ{x} {x}displ shift{x} {x}shift"
    " d{u} δ{u} {u}p {u}pix {u}pic shift{u} displ{u} {u}mean mean{u} deformation{x} deformation{u} 位移{x} {x}位移"
    " смещение{x} перемещение{x}"
    " verschiebung{x} {x}verschiebung déplacement{x} deplacement{x} spostamento{x} desplazamiento{x} 変位{x} {x}変位",
}
_PER_FRAME = {"{u}": "v{x} velocity{x} velocity{u} {u}velocity"}
"""Names of velocities, which are displacements if their unit is px."""
_AXES = (
    {"x": "x", "u": "u", "along": "horizontal", "line": "col cols column columns"},
    {"x": "y", "u": "v", "along": "vertical", "line": "row rows"},
)
_ROLES = {
    name: role.format(**axis) for role, names in _SPELLINGS.items() for axis in _AXES for name in names.format(**axis).split()
}  # fmt: skip
"""Column of a map, ``x``, ``y``, ``u`` or ``v``, by other usual spellings of its name."""
_IF_NO_OTHER = ("du", "dv", "up", "vp", "umean", "vmean", "meanu", "meanv", "xp", "yp", "px", "py")
"""Names that may also mean an uncertainty, a gradient or a fluctuation next to another name of the displacement."""
LENGTHS = ("mm", "um", "µm", "μm", "nm", "m", "cm", "in", "inch", "mil")
"""Units that a map must not have."""
_ROLES_IN_PIXELS = _ROLES | {
    name: role.format(**axis) for role, names in _PER_FRAME.items() for axis in _AXES for name in names.format(**axis).split()
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class TableDialect:
    """Table format of one DIC program.

    Attributes:
        name: name of the program, as in ``--from``.
        place: columns of x, y, u, v in px.
        sigma: columns of the standard uncertainties of u and v; None without.
        mark: column that marks valid points.
        min_mark: smallest mark of a valid point; NaN if small or large marks may mean one.
        lists_all_points: every point of the grid must be listed.
    """

    name: str
    place: tuple[str, str, str, str]
    sigma: tuple[str, str] | None
    mark: str
    min_mark: float
    lists_all_points: bool


DIALECTS = {
    dialect.name: dialect
    for dialect in (
        TableDialect("semlive", XYUV, ("sigma_u", "sigma_v"), "valid", 0.5, True),
        TableDialect("semlive-dic", XYUV, ("sigma_u", "sigma_v"), "status", 0.5, True),
        TableDialect("vic2d", XYUV, ("sigma", "sigma"), "sigma", 0.0, False),
        TableDialect("dice", ("coordinate_x", "coordinate_y", "displacement_x", "displacement_y"), ("sigma", "sigma"), "sigma", 0.0, False),
        TableDialect("other", XYUV, None, "valid", 0.5, False),
        TableDialect("opencorr", XYUV, None, "zncc", 0.0, False),
        TableDialect("pyvale", ("subset_x", "subset_y", "displacement_u", "displacement_v"), None, "converged", 0.5, False),
    )
}


def places_of(columns: tuple[Column, ...], dialect: str | None) -> tuple[int, ...]:
    """Return the places of the columns of numbers; a status may be text.

    Raises:
        BadInput: a required column is missing, occurs twice, or has another unit.
    """
    kind = dialect_of(columns, dialect)
    return tuple(place for name, place in columns_in(columns, kind).items() if name not in TEXT_MARKS)


def columns_in(columns: tuple[Column, ...], kind: TableDialect) -> dict[str, int]:
    """Return the places of the existing columns of a dialect, by its names."""
    keys = _keys(columns)
    names = dict.fromkeys((*kind.place, *(kind.sigma or ()), kind.mark, *marks_in(keys, kind)))
    return {name: keys.index(key_of(name)) for name in names if key_of(name) in keys}


def marks_in(keys: list[str], kind: TableDialect) -> tuple[str, ...]:
    """Return the columns of marks of a map, the one of its dialect first; other numbers count only without a mark of known sense."""
    present = [mark for mark in MARKS if mark in keys and mark != kind.mark]
    if kind.mark in keys and kind.mark not in (*UNKNOWN_SENSE, *FOUND_AT):
        present = [mark for mark in present if mark in (VALID, INVALID)]
    if kind.name not in ("semlive-dic", "opencorr"):
        present += [name for name in CORRELATION if name in keys]
    return ((kind.mark,) if key_of(kind.mark) in keys else ()) + tuple(present)


def dialect_of(columns: tuple[Column, ...], name: str | None) -> TableDialect:
    """Return the dialect of a map by its name, or else by its columns; errors begin with ``{head}``, the line of names."""
    keys = _keys(columns)
    for column, key in zip(columns, keys, strict=True):
        if key in _IN_PIXELS and column.unit and column.unit.casefold() not in PIXELS:
            raise BadInput(f"{{head}}, column {column.name}: is in {column.unit[:20]!r}; export it in pixels.")
        other = next(((line, unit) for line, unit in column.title_units if unit.casefold() in LENGTHS), None)
        if key in _IN_PIXELS and other:
            raise BadInput(
                f"{{head}}, column {column.name}: has no unit, but line {other[0]} states {other[1]!r}; export it in pixels, as 'u [px]'."
            )
    kind = DIALECTS[name or _detected_dialect(keys, [column.key for column in columns])]
    required = [*kind.place, *([kind.mark] if kind.mark != VALID else [])]
    for column_name in required:
        if key_of(column_name) not in keys:
            raise BadInput(f"{{head}}: column {column_name} is missing; a map of {kind.name} has {', '.join(required)}.")
    other_mark = next((mark for mark in MARKS if mark in keys), VALID)
    if kind.mark not in TEXT_MARKS and other_mark in keys:
        raise BadInput(f"{{head}}: columns {kind.mark} and {other_mark} both mark the points that were found; keep one.")
    if kind.mark == VALID and other_mark != VALID:
        kind = replace(kind, mark=other_mark, min_mark=math.nan, lists_all_points=False)
    for column_name in (*required, *(kind.sigma or ()), kind.mark, *marks_in(keys, kind)):
        if keys.count(key_of(column_name)) > 1:
            raise BadInput(f"{{head}}: column {column_name} occurs twice; keep one.")
    if kind.sigma is not None and (key_of(kind.sigma[0]) in keys) != (key_of(kind.sigma[1]) in keys):
        missing = kind.sigma[0] if key_of(kind.sigma[0]) not in keys else kind.sigma[1]
        raise BadInput(f"{{head}}: column {missing} is missing; give sigma_u and sigma_v, or neither.")
    return kind


def _keys(columns: tuple[Column, ...]) -> list[str]:
    """Return the keys of the columns; other usual spellings of x, y, u and v are replaced where the map has no column of that name.

    Raises:
        BadInput: two columns may be meant.
    """
    keys = [column.key for column in columns]
    if ("coordinatex" in keys and "displacementx" in keys and "sigma" in keys) or "subsetx" in keys:
        return keys
    in_pixels = [column.unit.casefold() in PIXELS for column in columns]
    names, roles = (
        list(keys),
        [_ROLES_IN_PIXELS.get(key, key) if is_px else _ROLES.get(key, key) for key, is_px in zip(keys, in_pixels, strict=True)],
    )
    places_in_pixels = [place for place, is_px in enumerate(in_pixels) if is_px]
    for place, column in enumerate(columns):
        same = [names[other] == names[place] for other in places_in_pixels if roles[other] == roles[place]]
        if same and not in_pixels[place] and (column.unit or any(same)):
            keys[place] = roles[place] = ""  # X [mm], or x, next to x [px]
        elif SPELLINGS.get(keys[place]) not in (None, *keys):
            keys[place] = SPELLINGS[keys[place]]
    for role in XYUV:
        places = [place for place, found in enumerate(roles) if found == role]
        if role in keys or not places:
            continue
        places = [place for place in places if keys[place] not in _IF_NO_OTHER] or places
        if len(places) > 1:
            both = " or ".join(repr(columns[place].raw) for place in places[:2])
            raise BadInput(f"{{head}}: column {role} may be {both}; keep one.")
        keys[places[0]] = role
    return keys


def _detected_dialect(keys: list[str], names: list[str]) -> str:
    """Return the dialect of a map by the keys of its columns, and by their own names, which differ for other programs."""
    if "coordinatex" in keys and "displacementx" in keys:
        return "dice"
    if "subsetx" in keys:
        return "pyvale"
    if "zncc" in keys and "status" in keys:
        return "semlive-dic"
    if "zncc" in keys and "convergence" in keys:
        return "opencorr"
    if "sigma" in keys and "sigmau" not in keys:
        return "vic2d"
    return "semlive" if all(name in names for name in XYUV) else "other"
