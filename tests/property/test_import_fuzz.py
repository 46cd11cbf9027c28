"""For any content of the files of an import the result is a value or one message, never another exception."""

from __future__ import annotations

import random

from hypothesis import example, given, settings
from hypothesis import strategies as st

from semlive.data.disparity import DisparityMap
from semlive.errors import BadInput
from semlive.formats.tables.disparity_columns import DIALECTS
from semlive.formats.tables.disparity_grid import check_inside, grid_of, map_on
from semlive.formats.tables.disparity_table import read_disparity_table
from semlive.formats.tables.frame_table import read_frame_table

FRAMES = b"""frame,pair,phase,start_s,dwell_s,row_time_s,width,height,integrations,load_n,shift_x_px,shift_y_px
0,0,calibration,0.0,1e-5,0.0110,1000,800,1,,0,0
1,0,calibration,10.0,1e-5,0.0110,1000,800,1,,0,0
2,1,tension,30.0,1e-5,0.0110,1000,800,1,250.5,,
3,1,tension,40.0,1e-5,0.0110,1000,800,1,250.5,,
"""
MAP = b"x,y,u,v,sigma_u,sigma_v,valid\n" + b"".join(b"%d,%d,0.5,-1e-3,0.01,0.01,1\n" % (x, y) for y in (10, 20, 30) for x in (10, 20, 30))
NASTY = (
    b"nan",
    b"inf",
    b"-1",
    b"1e400",
    b"",
    b'"',
    b",",
    b"\n",
    b"\r",
    b"\x00",
    b"\xff",
    b";",
    b"9" * 30,
    b"0x10",
    b"***",
    b"#",
    b"\t",
    b"1_0",
    "٣".encode(),
)


def spoilt(data: bytes, seed: int) -> bytes:
    """The file with a few cells, bytes or lines replaced."""
    rng = random.Random(seed)
    for _ in range(rng.randint(1, 4)):
        at, length = rng.randrange(len(data) + 1), rng.choice((0, 1, 3, 12))
        data = data[:at] + rng.choice(NASTY) + data[at + length :]
    return data


def one_sentence(error: BadInput) -> None:
    assert "\n" not in str(error)
    assert str(error).endswith(".")


def read_map(data: bytes, dialect: str | None) -> DisparityMap | None:
    try:
        table = read_disparity_table(data, "map.csv", dialect)
        check_inside(table, 1000, 800)
        return map_on(table, grid_of(table, 0), 0, 1)
    except BadInput as error:
        one_sentence(error)
    return None


@given(st.binary(max_size=300))
@example(b"frame\n")
@settings(max_examples=150, deadline=None)
def test_any_bytes(data: bytes) -> None:
    read_map(data, None)
    try:
        read_frame_table(data, "frames.csv")
    except BadInput as error:
        one_sentence(error)


@given(st.integers(0, 2**32), st.sampled_from([None, *DIALECTS]))
@settings(max_examples=300, deadline=None)
def test_a_spoilt_map(seed: int, dialect: str | None) -> None:
    found = read_map(spoilt(MAP, seed), dialect)
    if found is not None:
        assert abs(found.u_px).max() < 1000
        assert (found.sigma_u_px >= 0).all()


@given(st.integers(0, 2**32))
@settings(max_examples=300, deadline=None)
def test_a_spoilt_table_of_frames(seed: int) -> None:
    try:
        rows = read_frame_table(spoilt(FRAMES, seed), "frames.csv")
    except BadInput as error:
        one_sentence(error)
    else:
        assert [row.frame for row in rows] == sorted({row.frame for row in rows})
