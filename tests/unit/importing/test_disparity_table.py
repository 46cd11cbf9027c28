"""Maps of several engines: the same map in every dialect is the same map; errors name file, line and column."""

from __future__ import annotations

import re

import numpy as np
import pytest

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.errors import BadInput
from semlive.formats.tables.disparity_grid import check_inside, grid_of, map_on, scatter_px
from semlive.formats.tables.disparity_table import read_disparity_table

GRID = Grid(20, 30, 10, 5, 4, 0)
X, Y = (one.ravel() for one in GRID.mesh())
RNG = np.random.default_rng(3)
U, V = (np.round(RNG.normal(1.0, 2.0, X.size), 6) for _ in range(2))
LOST = 7  # a point that every engine marks as not found


def text(header: str, row: str, *, above: str = "", skip: bool = False) -> bytes:
    lines = [
        row.format(i=i, x=x, y=y, u=0.0 if lost else u, v=0.0 if lost else v, sigma=-1 if lost else 0.01, zncc=-4 if lost else 0.98,
                   ok=int(not lost),
                   word="low_zncc" if lost else "converged", nan="nan" if lost else u)
        for i, (x, y, u, v) in enumerate(zip(X, Y, U, V, strict=True))
        for lost in (i == LOST,)
        if not (skip and lost)
    ]  # fmt: skip
    return (above + "\n".join([header, *lines]) + "\n").encode()


DICE = "SUBSET_ID,COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y,SIGMA,GAMMA,BETA,STATUS_FLAG,UNCERTAINTY"
DICE_ROW = "{i},{x:.4E},{y:.4E},{u:.8E},{v:.8E},{sigma:.4E},2.1E-02,0.0E+00,4.0E+00,7.6E-03"
VIC = '"x", "y", "u", "v", "sigma", "exx", "eyy", "exy"'
VIC_ROW = "{x:.6f}, {y:.6f}, {u:.6f}, {v:.6f}, {sigma}, 0.0, 0.0, 0.0"
CORR = "x,y,u,v,u0,v0,ZNCC,iteration,convergence,feature,exx,eyy,exy,subset_rx,subset_ry,"
CORR_ROW = "{x:.8f},{y:.8f},{u:.8f},{v:.8f},0,0,{zncc},3,0.0001,0,0,0,0,16,16,"
VALE = "subset_x,subset_y,displacement_u,displacement_v,displacement_mag,converged,cost,ftol,xtol,num_iterations"
VALE_ROW = "{x:.0f},{y:.0f},{nan},{nan},1.0,{ok},0.99,1e-6,1e-6,4"
DIALECTS = {
    "semlive": text("x,y,u,v,valid", "{x:.0f},{y:.0f},{u},{v},{ok}"),
    "semlive with uncertainties": text("x,y,u,v,sigma_u,sigma_v,valid", "{x:.0f},{y:.0f},{u},{v},0.01,0.02,{ok}"),
    "semicolons": text("x;y;u;v;valid", "{x:.0f};{y:.0f};{u};{v};{ok}"),
    "nothing where nothing was found": text("x,y,u,v,valid", "{x:.0f},{y:.0f},{u},{v},{ok}").replace(b"0.0,0.0,0", b",,0"),
    "semlive dic": text("x,y,u,v,sigma_u,sigma_v,zncc,status", "{x:.0f},{y:.0f},{u},{v},0.01,0.01,0.9,{word}"),
    "vic2d": text(VIC, VIC_ROW),
    "vic2d with units": text('"x [pixel]","y [pixel]","u [pixel]","v [pixel]","sigma [pixel]"', "{x},{y},{u},{v},{sigma}"),
    "vic2d, point left out": text(VIC, VIC_ROW, skip=True),
    "dice": text(DICE, DICE_ROW),
    "dice with its header": text(
        DICE, DICE_ROW, above="***\n*** Digital Image Correlation Engine (DICe)\n*** Subset size: 27\n***\n", skip=True
    ),
    "opencorr": text(CORR, CORR_ROW),
    "pyvale": text(VALE, VALE_ROW).replace(f"{V[0]}".encode(), f"{V[0]}".encode()),
}


def laid(data: bytes) -> DisparityMap:
    table = read_disparity_table(data, "disparity_0_2.csv")
    check_inside(table, 200, 200)
    return map_on(table, grid_of(table, table.subset_px), 0, 2)


@pytest.mark.parametrize("name", DIALECTS)
def test_every_dialect_gives_the_same_map(name: str) -> None:
    found = laid(DIALECTS[name])
    expected = np.arange(X.size).reshape(GRID.shape) != LOST
    assert (found.grid.x0_px, found.grid.y0_px, found.grid.step_px, found.grid.nx, found.grid.ny) == (20, 30, 10, 5, 4)
    np.testing.assert_array_equal(found.valid, expected)
    np.testing.assert_array_equal(found.u_px, np.where(expected, U.reshape(GRID.shape), 0.0))
    if name != "pyvale":  # its v is written as u here, to be NaN where lost
        np.testing.assert_array_equal(found.v_px, np.where(expected, V.reshape(GRID.shape), 0.0))
    assert found.grid.subset_px == (27 if "header" in name else 0)


def test_the_order_of_lines_does_not_matter() -> None:
    head, *lines = DIALECTS["semlive"].decode().splitlines()
    turned = "\n".join([head, *lines[::-1]]).encode()
    np.testing.assert_array_equal(laid(turned).u_px, laid(DIALECTS["semlive"]).u_px)


def good() -> list[str]:
    return text("x,y,u,v", "{x:.0f},{y:.0f},{u},{v}").decode().splitlines()


def changed(line: int, column: int, value: str) -> str:
    lines = good()
    cells = lines[line - 1].split(",")
    cells[column] = value
    lines[line - 1] = ",".join(cells)
    return "\n".join(lines)


LEVEL = text("x,y,u,v", "{x:.0f},{y:.0f},1.5,-2").decode().splitlines()
STILL = "\n".join([*LEVEL[:8], LEVEL[8].replace("1.5,-2", "0,0"), *LEVEL[9:]])
IN_MM = [",".join(f"{float(cell) / 100:.3f}" for cell in line.split(",")) for line in good()[1:]]
WRONG = {
    "empty file": ("", "is empty"),
    "only a header": ("x,y,u,v\n", "line 2: holds no point"),
    "missing column": ("\n".join(good()).replace("x,y,u,v", "x,y,u,w"), "line 1: column v is missing"),
    "one sigma": ("\n".join(["x,y,u,v,sigma_u", *(line + ",0.1" for line in good()[1:])]), "line 1: column sigma_v is missing"),
    "unit": ("\n".join(good()).replace("x,y,u,v", "x,y,u [mm],v"), "line 1, column u: is in 'mm'; export it in pixels"),
    "nan where found": ("\n".join(DIALECTS["semlive"].decode().splitlines()).replace(f"{U[3]},", "NaN,"), "line 5, column u: is nan"),
    "position lost": (changed(5, 0, "NaN"), "line 5, column x: is nan"),
    "infinite": (changed(5, 3, "inf"), "line 5, column v: is inf"),
    "word": (changed(6, 3, "left"), "line 6, column v: 'left' is not a number"),
    "empty position": (changed(6, 1, ""), "line 6, column y: is empty"),
    "unit mm": ("\n".join(good()).replace("x,y,u,v", "x,y,Displacement x [mm],Displacement y [mm]"), "is in 'mm'; export it in pixels"),
    "u twice": ("\n".join(good()).replace("x,y,u,v", "x,u_x,x_displacement,y"), "column u may be 'u_x' or 'x_displacement'"),
    "DaVis, mm": ('#DaVis 8.4.0 2D-vector 4 9 9 "" "mm" "" "mm" "displacement" "px"\n' + "1 2 3 4\n" * 9, "states the unit 'mm'"),
    "line too short": (changed(6, 3, "1").replace(good()[8], "20,30"), "line 9: has 2 cells under 4 names, separated by commas"),
    "half a pixel": (changed(4, 0, "40.5"), "line 4, column x: 40.5 is not an integer"),
    "millimetres": ("\n".join(["x,y,u,v", *IN_MM]), "is not an integer"),
    "off the grid": (changed(4, 0, "43"), "line 4, column x: 43 is not on the grid of the first map (20, 30, ... 60)"),
    "before the grid": (changed(4, 0, "17"), "line 4, column x: 17 is not on the grid of the first map (20, 30, ... 60)"),
    "point twice": ("\n".join([*good(), good()[3]]), "line 22, column x: the point (40, 30) occurs twice"),
    "point missing": ("\n".join(good()[:-2] + good()[-1:]), "1 points of the grid are missing, the first (50, 60)"),
    "lost marked as still": (STILL, "line 9, column u: 1 points moved by exactly 0 where the points around them moved by 2.5 px"),
    "one pair of numbers in many places": (
        "\n".join([*LEVEL[:3], *(line.replace("1.5,-2", "-31,-31") for line in LEVEL[3:7]), *LEVEL[7:]]),
        "line 4, column u: 4 points moved by exactly (-31, -31) px, and all points around them by 43.6 px less or more; mark with",
    ),
    "outside the frame": (changed(2, 0, "-20"), "line 2, column x: -20 px is outside the frame of 200 x 200 px"),
    "longer than the frame": (changed(2, 2, "4000"), "line 2, column u: 4000 px is longer than the frame"),
    "one row": ("\n".join(good()[:6]), "the map has 1 different y"),
    "not text": ("x,y,u,v\n\x01\x02", "is not plain text"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_an_error_is_reported_with_its_place(name: str) -> None:
    body, message = WRONG[name]
    with pytest.raises(BadInput, match=re.escape(message)) as wrong:
        laid(body.encode("latin-1"))
    assert str(wrong.value).startswith("disparity_0_2.csv: ")
    assert "\n" not in str(wrong.value)


def test_a_truly_stationary_point_is_accepted() -> None:
    turned = "\n".join(["x,y,u,v", *(f"{x:.0f},{y:.0f},{0.02 * (y - 40):.3f},{-0.02 * (x - 40):.3f}" for x, y in zip(X, Y, strict=True))])
    found = laid(turned.encode())
    assert found.valid.all()
    assert ((found.u_px == 0.0) & (found.v_px == 0.0)).sum() == 1


def test_a_map_on_another_grid_is_refused() -> None:
    table = read_disparity_table(DIALECTS["vic2d"], "disparity_0_4.csv")
    with pytest.raises(
        BadInput, match=r"disparity_0_4\.csv: line 2, column x: 20 is not on the grid of the first map \(25, 35, \.\.\. 65\)"
    ):
        map_on(table, Grid(25, 30, 10, 5, 4, 0), 0, 4)


@pytest.mark.parametrize("shared", [False, True])
def test_noise_that_an_engine_does_not_report_is_estimated_from_the_map(shared: bool) -> None:
    y, x = np.mgrid[0:120, 0:150] * 5.0
    smooth = np.cos(2 * np.pi * x / 1000) + 1e-5 * x * y
    noise = RNG.normal(0.0, 1.0, (128, 158))
    if shared:
        noise = np.sum([noise[i : i + 120, j : j + 150] for i in range(8) for j in range(8)], axis=0) / 8
    found = scatter_px(smooth + 0.025 * noise[:120, :150], np.ones((120, 150), dtype=bool))
    assert found == pytest.approx(0.025, rel=0.1)


LOST_MARKS = ("", "nan", "NaN", "-nan(ind)", "1.#QNAN", "-1.#IND", "#N/A", "#NV", "--", "n/a", "null", "nan(snan)",
              "#NUM!", "#NAME?", "#REF!", "#VALUE!", "#DIV/0!", "#BEZUG!", "#¡NUM!", "n.a.", "NA", "k. A.", "####", "—",
              "?", "missing", "undefined", "n.d.", "no data", "invalid", "\\N", "NaN+NaNi")  # fmt: skip
PLACES = "{x:.0f},{y:.0f},{u},{v}"
NAMES = {
    "MatchID": "Coordinates.Image X [Pixel],Coordinates.Image Y [Pixel],"
    "disp.Horizontal Displacement U [Pixel],disp.Vertical Displacement V [Pixel]",
    "muDIC": "coord_x,coord_y,ux,uy",
    "DaVis": "x [px],y [px],Displacement x [px],Displacement y [px]",
    "GOM": "x (pixel),y (pixel),displacement_x (pixel),displacement_y (pixel)",
    "Ncorr": "x,y,u_ref,v_ref",
    "capitals": "X,Y,U,V",
    "units behind underscores": "x_px,y_px,u_px,v_px",
    "words": "X position,Y position,U displacement,V displacement",
}


@pytest.mark.parametrize(("name", "mark"), [*((name, "") for name in NAMES), *(("MatchID", mark) for mark in LOST_MARKS[1:])])
def test_usual_names_and_marks_of_lost_points_are_read(name: str, mark: str) -> None:
    lines = text(NAMES[name], PLACES).decode().splitlines()
    lines[LOST + 1] = f"{X[LOST]},{Y[LOST]},{mark},{mark}"
    found = laid("\n".join(lines).encode())
    expected = np.arange(X.size).reshape(GRID.shape) != LOST
    np.testing.assert_array_equal(found.valid, expected)
    np.testing.assert_array_equal(found.u_px, np.where(expected, U.reshape(GRID.shape), 0.0))
    np.testing.assert_array_equal(found.v_px, np.where(expected, V.reshape(GRID.shape), 0.0))


def test_lines_without_any_value_are_omitted() -> None:
    lines = text("x,y,u,v", PLACES, skip=True).decode().splitlines()
    extended = "\n".join([*lines[:4], ",,,", *lines[4:6], "nan,nan,nan,nan", *lines[6:]])
    assert read_disparity_table(extended.encode(), "a").x_px.tolist() == read_disparity_table("\n".join(lines).encode(), "a").x_px.tolist()


@pytest.mark.parametrize("encoding", ["cp1252", "cp932", "utf-16", "utf-16-le", "utf-8-sig"])
def test_remarks_in_another_code_page_do_not_matter(encoding: str) -> None:
    lines = text("x;y;u;v;Größe".replace("öß", "μ") if encoding == "cp932" else "x;y;u;v;Größe", "{x:.0f};{y:.0f};{u};{v};1").decode()
    assert read_disparity_table(lines.encode(encoding), "a").u_px[0] == U[0]


def test_a_vector_file_of_davis_is_read() -> None:
    body = text("", "{x:.0f}\t{y:.0f}\t{u}\t{v}", skip=True).decode().replace(".", ",")
    data = ('#DaVis 8.4.0 2D-vector 10 4 5 "" "px" "" "px" "displacement" "px"' + body).encode()
    assert read_disparity_table(data, "a").u_px[0] == U[0]


def test_old_line_ends_are_read() -> None:
    assert read_disparity_table(DIALECTS["semlive"].replace(b"\n", b"\r"), "a").u_px[0] == U[0]


def test_other_programs_may_leave_lost_points_out() -> None:
    names = NAMES["muDIC"]
    found = laid(text(names, PLACES, skip=True))
    assert int(found.valid.sum()) == X.size - 1
    with pytest.raises(BadInput, match="points of the grid are missing"):
        laid(text("x,y,u,v", PLACES, skip=True))


def test_a_blank_line_below_the_names_does_not_shift_the_lines() -> None:
    lines = text("x,y,u,v", PLACES, skip=True).decode().splitlines()
    table = read_disparity_table("\n".join([lines[0], "", *lines[1:]]).encode(), "a")
    assert str(table.error(0, 0, "is wrong", "correct it")).startswith("a: line 3, ")


def test_a_lost_cell_and_a_decimal_comma_make_no_displacement() -> None:
    """-27.88 px without the other displacement was read as -2 and 7880 px."""
    with pytest.raises(BadInput, match=r"line 3: may mean '-2' and '788e\+01', or '-2,788e\+01'"):
        read_disparity_table(b"X,Y,u_ref,v_ref\n628,66,0,-21\n633,66,-2,788e+01\n", "map")
    assert read_disparity_table(b"X,Y,u_ref,v_ref\n628,66,0.5,-21\n633,66,2,7e-01\n", "map").v_px.tolist() == [-21.0, 0.7]


@pytest.mark.parametrize("head", ["% x y u v", "! x, y, u, v", "# x | y | u | v", "# x;y;u;v"])
def test_names_in_comments_of_other_programs(head: str) -> None:
    table = read_disparity_table(f"{head}\n10 20 0.5 -0.25\n20 20 0.5 -0.25\n".encode(), "map")
    assert (table.x_px.tolist(), table.v_px.tolist()) == ([10.0, 20.0], [-0.25, -0.25])


@pytest.mark.parametrize(("whole", "torn"), [("0.55", "0.5"), ("0.55", "0."), ("-5.500000e-03", "-5.500000e-0"), ("5.5e-03", "5.5")])
def test_a_last_number_that_is_cut_off_is_refused(whole: str, torn: str) -> None:
    lines = [f"{20 * column},{20 * row},1.36,{whole}" for row in range(4) for column in range(4)]
    text = "\n".join(["x,y,u,v", *lines])
    assert read_disparity_table(text.encode(), "a.csv").v_px[-1] == float(whole)
    with pytest.raises(BadInput, match=f"line 17: ends with '{torn}' without a line feed"):
        read_disparity_table(text.removesuffix(whole).encode() + torn.encode(), "a.csv")


def test_a_last_number_of_varying_digits_needs_no_line_feed() -> None:
    lines = [f"{20 * column},{20 * row},1.36,{0.25 * row}" for row in range(4) for column in range(4)]
    assert read_disparity_table("\n".join(["x,y,u,v", *lines, "0,80,1.36,1"]).encode(), "a.csv").v_px[-1] == 1.0
