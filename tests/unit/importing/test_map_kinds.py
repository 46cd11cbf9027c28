"""Maps as laboratories export them: titles, marks as texts, other names, summaries; each is read right, or refused with the reason."""

from __future__ import annotations

import numpy as np
import pytest

from semlive.errors import BadInput
from semlive.formats.tables.disparity_grid import grid_of, map_on
from semlive.formats.tables.disparity_table import DisparityTable, read_disparity_table
from semlive.formats.tables.sentinels import doubtful_pair

POINTS = [(20 + 10 * column, 30 + 10 * row) for row in range(3) for column in range(4)]
U = [1.25 + 0.01 * place for place in range(len(POINTS))]
LOST = 5  # the point that was not found, where a test has one
NAMES = "x;y;u;v"


def lines(mark: tuple[str, str] | None = None, lost: str = "", separator: str = ";", decimal: str = ".") -> list[str]:
    """Return the points of the map as lines, with a mark of found and of lost points."""
    cells = [[str(x), str(y), f"{u:.4f}", f"{-u:.4f}"] for (x, y), u in zip(POINTS, U, strict=True)]
    if lost:
        cells[LOST][2:] = [lost, lost]
    if mark is not None:
        cells = [[*row, mark[place == LOST]] for place, row in enumerate(cells)]
    return [separator.join(cell.replace(".", decimal) for cell in row) for row in cells]


def read(*text: str, encoding: str = "utf-8") -> DisparityTable:
    return read_disparity_table("\n".join([*text, ""]).encode(encoding), "map.csv")


def check(table: DisparityTable, lost: int | None = None) -> None:
    found = map_on(table, grid_of(table, 0), 0, 2)
    expected = np.array(U).reshape(3, 4)
    valid = np.arange(len(U)).reshape(3, 4) != (-1 if lost is None else lost)
    np.testing.assert_array_equal(found.valid, valid)
    np.testing.assert_allclose(found.u_px, np.where(valid, expected, 0.0), rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.v_px, np.where(valid, -expected, 0.0), rtol=0, atol=1e-12)


TITLES = {
    "one line": ["Displacement field of specimen 7"],
    "cells": ["Project;Specimen 7", "Date;14.03.2022 11:52", ""],
    "numbers": ["Image size;1024;768;px", "Step;10;;"],
    "keys": ["Subset: 21", "Step: 10"],
    "a list of the columns": ["Columns: x;y;u;v"],
    "sections": ["[Data]"],
    "quotes": ['"Specimen 7, run 3"'],
    "names twice": [NAMES],
    "remarks that begin like error values": ["#Number of points: 12", "#Name: run 7", "#Reference frame 0", "#NaCl crystal"],
}


@pytest.mark.parametrize("title", TITLES.values(), ids=TITLES)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_titles_above_the_names_are_skipped(title: list[str], encoding: str) -> None:
    check(read(*title, NAMES, *lines(), encoding=encoding))
    check(read(*title, NAMES, "[px];[px];px;px", *lines(decimal=","), encoding=encoding))


@pytest.mark.parametrize(
    "mark",
    [("True", "False"), ("yes", "no"), ("JA", "Nein"), ("WAHR", "FALSCH"), ("vrai", "faux"), ("Y", "N"), ("ok", "lost"), ("1.0", "0.0")],
)
@pytest.mark.parametrize("column", ["valid", "is_valid", "Found", "converged"])
def test_marks_may_be_texts(mark: tuple[str, str], column: str) -> None:
    check(read(f"{NAMES};{column}", *lines(mark)), LOST)
    check(read(f"{NAMES};{column}", *lines(mark, "#NUM!")), LOST)


@pytest.mark.parametrize("mark", [("1", "0"), ("0", "1"), ("False", "True")])
def test_a_mask_is_used_as_its_lost_points_show(mark: tuple[str, str]) -> None:
    """A mask is 1 at points of the region (Ncorr), or at points that are masked out (numpy)."""
    for lost in ("nan", "0"):
        check(read(f"{NAMES};mask", *lines(mark, lost)), LOST)
    check(read(f"{NAMES};mask", *lines((mark[0], mark[0]))))
    with pytest.raises(BadInput, match="column mask: more than one of its values may mark points that were found; name it valid"):
        read(f"{NAMES};mask", *lines(mark))
    check(read(f"{NAMES};outlier", *lines(("no", "yes"))), LOST)


@pytest.mark.parametrize(
    "names",
    [
        "x;y;delta_x;delta_y",
        "x;y;dx;dy",
        "X;Y;Disp_U;Disp_V",
        "x [px];y [px];ΔX [px];ΔY [px]",
        "X-Koordinate;Y-Koordinate;Verschiebung X;Verschiebung Y",
        "x;y;déplacement x;déplacement y",
        "x;y;X変位;Y変位",
        "ｘ;ｙ;ｕ;ｖ",
        "col;row;u;v",
        "x0;y0;u [px/frame];v [px/frame]",
        "xp;yp;up;vp",
        "x;y;du;dv",
        "x;y;deformation_x;deformation_y",
        "X_Pic;Y_Pic;U_Pic;V_Pic",
        "x [px];y [px];Vx [pixel/frame];Vy [pixel/frame]",
        "坐标X;坐标Y;位移X;位移Y",
    ],
)
def test_other_names_are_read(names: str) -> None:
    check(read(names, *lines()))


def test_columns_in_another_unit_next_to_pixels_are_left_out() -> None:
    check(read('"X [mm]";"Y [mm]";"x [pixel]";"y [pixel]";u [px];v [px];U [mm];V [mm]', *(f"0.1;0.2;{line};9;9" for line in lines())))


def test_a_tecplot_file_is_read() -> None:
    head = ['TITLE = "run 7"', 'VARIABLES = "x", "y", "u", "v"', 'ZONE T="Frame 0", I=4, J=3', "STRANDID=1, SOLUTIONTIME=0"]
    check(read(*head, *lines(separator=" ")))
    check(read('VARIABLES = "x"', '"y"', '"u"', '"v"', "ZONE I=4, J=3, F=POINT", *lines(separator="\t")))
    with pytest.raises(BadInput, match=r"line 2: lists the values variable by variable"):
        read(head[1], "ZONE I=4, J=3, DATAPACKING=BLOCK", "20 30 40 50", "20 30 40 50")


PROGRAMS: dict[str, tuple[list[str], str, str]] = {
    "R": (['"x" "y" "u" "v"'], '"{i}" {x} {y} {u} {v}', '"{i}" {x} {y} NA NA'),
    "R, decimal commas": (['"x";"y";"u";"v"'], '"{i}";{x},0;{y},0;{u};{v}'.replace(",0", ""), '"{i}";{x};{y};NA;NA'),
    "R, commas": (['"","x","y","u","v"'], '"{i}",{x},{y},{u},{v}', '"{i}",{x},{y},NA,NA'),
    "OpenPIV, replaced": (["# x\ty\tu\tv\tflags\tmask"], "{x}.0\t{y}.0\t{u}\t{v}\t0.0\t0.0", "{x}.0\t{y}.0\t9.5\t1.5\t1.0\t0.0"),
    "OpenPIV, masked": (["# x\ty\tu\tv\tflags\tmask"], "{x}.0\t{y}.0\t{u}\t{v}\t0.0\t0.0", "{x}.0\t{y}.0\t9.5\t1.5\t0.0\t1.0"),
    "PIVlab, interpolated": (
        ["PIVlab, ASCII chart output", "x [px],y [px],u [px/frame],v [px/frame],Vector type [-]"],
        "{x},{y},{u},{v},1",
        "{x},{y},9.5,1.5,2",
    ),
    "TSI Insight": (
        ['TITLE="A" VARIABLES="X pixel", "Y pixel", "U pixel", "V pixel", "CHC", DATASETAUXDATA Application="PIV"', "ZONE I=4, J=3"],
        "{x}, {y}, {u}, {v}, 1",
        "{x}, {y}, 9.5, 1.5, -2",
    ),
    "spam": (["Zpos\tYpos\tXpos\tZdisp\tYdisp\tXdisp\treturnStatus"], "0\t{y}\t{x}\t0\t{v}\t{u}\t2", "0\t{y}\t{x}\t0\t9.5\t1.5\t-1"),
    "DynamicStudio": (
        [">>*HEADER*<<", ">>*DATA*<<", "x,y,x (pix)[pix],y (pix)[pix],x (mm)[mm],y (mm)[mm],U pix[pix],V pix[pix],U[m/s],V[m/s],Status"],
        "0,1,{x},{y},0.5,0.2,{u},{v},0.1,0.2,0",
        "0,1,{x},{y},0.5,0.2,NaN,NaN,0.1,0.2,0",
    ),
    "DaVis, zeros": (
        ["x [px];y [px];Displacement x [px];Displacement y [px];Correlation value []"],
        "{x};{y};{u};{v};0.9",
        "{x};{y};0;0;0",
    ),
    "-9999": (["x,y,u,v"], "{x},{y},{u},{v}", "{x},{y},-9999,-9999"),
    "999.999": (["x,y,u,v"], "{x},{y},{u},{v}", "{x},{y},{u},999.999"),
    "1e+37": (["x,y,u,v"], "{x},{y},{u},{v}", "{x},{y},1e+37,1e+37"),
    "-99": (["x,y,u,v"], "{x},{y},{u},{v}", "{x},{y},-99,-99"),
    "-32768": (["x,y,u,v"], "{x},{y},{u},{v}", "{x},{y},-32768,{v}"),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_lost_points_of_many_programs_are_recognized(name: str) -> None:
    head, found, lost = PROGRAMS[name]
    rows = [
        (lost if place == LOST else found).format(i=place + 1, x=x, y=y, u=f"{u:.2f}", v=f"{-u:.2f}")
        for place, ((x, y), u) in enumerate(zip(POINTS, U, strict=True))
    ]
    rows = [row.replace(".", ",") for row in rows] if "commas" in name and "decimal" in name else rows
    check(read(*head, *rows), LOST)


@pytest.mark.parametrize("constant", ["3", "-1", "99", "-999"])
def test_a_rigid_motion_is_no_mark_of_lost_points(constant: str) -> None:
    table = read(NAMES, *(f"{x};{y};{constant};{constant}" for x, y in POINTS))
    assert map_on(table, grid_of(table, 0), 0, 2).u_px.tolist() == [[float(constant)] * 4] * 3


@pytest.mark.parametrize("lost", ["-1;-1", "0;{v}", "{u};0", "-5;-5"])
def test_a_mark_at_a_single_point_is_refused(lost: str) -> None:
    rows = lines()
    x, y, u, v = rows[LOST].split(";")
    rows[LOST] = f"{x};{y};{lost.format(u=u, v=v)}"
    table = read(NAMES, *rows)
    with pytest.raises(BadInput, match=r"line 7, column u: 1 points moved by exactly"):
        map_on(table, grid_of(table, 0), 0, 2)


@pytest.mark.parametrize("decimals", [0, 1, 4])
def test_rounded_displacements_and_a_crack_are_no_mark_of_lost_points(decimals: int) -> None:
    y, x = np.mgrid[0:40, 0:50] * 5.0
    noise = np.random.default_rng(5).normal(0.0, 0.02, (2, 40, 50))
    for u in (0.01 * x, np.where(x > 100, 5.0, 0.0), 0.03 * (y - 80)):
        assert doubtful_pair(*np.round((u + noise[0], 0.3 + noise[1]), decimals), np.ones(x.shape, dtype=bool)) is None


@pytest.mark.parametrize(
    "summary", [["Mean;;1.3;-1.3"], ["% end"], ["-----", "Mean;1.3"], ["", "Mean u = 1.3 px", "END"], ["Anzahl: 12;;;"]]
)
def test_a_summary_below_the_points_is_left_out(summary: list[str]) -> None:
    check(read(NAMES, *lines(), *summary))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ([], "map.csv: is empty; write the table again"),
        (["", " ", ";;;"], "map.csv: holds blank lines only"),
        (["# remark"], "map.csv: holds comments only"),
        ([NAMES], "line 2: holds no point"),
        (["Specimen 7", "x [mm];y [mm];u [mm];v [mm]", *lines()], "line 2, column x: is in 'mm'"),
        (["Run 7, a, b, c, d, e", "x,y,u", "20,30,1.5"], "line 2: column v is missing"),
        (["mm;mm;mm;mm", NAMES, *lines()], "line 2, column x: is in 'mm'"),
        ([f"{NAMES};sigma;valid", *(f"{line};0.1;1" for line in lines())], "columns sigma and valid both mark the points"),
        (["Run 7", *lines()], "line 2: holds numbers without names"),
        ([f"{NAMES};valid", *lines(("yes", "perhaps"))], "line 7, column valid: 'perhaps' is no mark"),
        ([NAMES, *lines()[:6], "Mean;;1.3;-1.3", *lines()[6:]], "line 8, column x: 'Mean' is not a number"),
        (["x;y;dx;dy;delta_x;delta_y", *(f"{line};0;0" for line in lines())], "column u may be 'dx' or 'delta_x'"),
        (["PK\x03\x04"], "is a spreadsheet"),
        (["Units: mm", NAMES, *lines()], "line 2, column x: has no unit, but line 1 states 'mm'; export it in pixels"),
        (
            [f"{NAMES};valid", *(f"{line};1" for line in lines(lost="-9999"))],
            "which marks a point that was not found, but valid marks it as found",
        ),
        (["# x;y;u;v;flags;mask", *(f"{line};0;0" for line in lines()[::-1])], "y decreases from line to line, so its axis points upward"),
    ],
)
def test_the_reason_is_true(text: list[str], reason: str) -> None:
    with pytest.raises(BadInput) as refused:
        read(*text) if text else read_disparity_table(b"", "map.csv")
    assert reason in str(refused.value)
