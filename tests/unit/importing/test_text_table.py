"""How text tables are written is decided from their heads, or they are refused with what they could mean."""

from __future__ import annotations

import math
import re

import pytest

from semlive.errors import BadInput
from semlive.inputs.text_table import (
    AmbiguousTable,
    Column,
    Convention,
    Layout,
    is_blank,
    key_of,
    layout_of,
    lines_of,
    number_in,
    text_of,
)


def read(text: str | bytes, *selected: str | int, given: Convention | None = None, searched: int = 1) -> tuple[Layout, list[list[float]]]:
    """The selected numbers of every line."""

    def places(columns: tuple[Column, ...]) -> tuple[int, ...]:
        keys = [column.key for column in columns]
        for name in selected:
            if (isinstance(name, str) and keys.count(key_of(name)) != 1) or (isinstance(name, int) and name > len(columns)):
                raise BadInput(f"{{head}}: column {name} is missing.")
        return tuple(name - 1 if isinstance(name, int) else keys.index(key_of(name)) for name in selected)

    lines = lines_of(text_of(text if isinstance(text, bytes) else text.encode(), "table"))
    layout = layout_of(lines, "table", places, given, searched)
    rows = []
    for number, line in enumerate(lines[layout.first_line - 1 :], layout.first_line):
        if not is_blank(line):
            cells = layout.cells(line, number)
            numbers = [number_in(cells[place], layout.decimal) for place in layout.number_places]
            assert None not in numbers, cells
            rows.append(numbers)
    return layout, rows


TRUTH = [[134.2, 0.5], [134.25, -0.5]]
SAME = {
    "commas": "Time,Force,Ext\n12.4,134.2,0.5\n12.5,134.25,-.5\n",
    "semicolons": "Time;Force;Ext\n12,4;134,2;0,5\n12,5;134,25;-0,5\n",
    "semicolons with points": "Time;Force;Ext\n12.4;134.2;0.5\n12.5;134.25;-0.5\n",
    "tabs": "Time\tForce\tExt\r\n12,4\t134,2\t0,5\r\n12,5\t134,25\t-5,0e-1\r\n",
    "blanks": "Time  Force   Ext\n12,4 134,2  0,5\n 12,5 134,25 -0,5 \n",
    "blanks with units": "Time (s)  Force (N)   Ext / mm\n12.4 134.2  0.5\n 12.5 134.25 -0.5 \n",
    "quotes": '"Time","Force","Ext"\n"12,4","134,2","0,5"\n"12,5","134,25","-0,5"\n',
    "quoted separator": 'Time,"Force",Ext,"a, ""b"""\n12.4,134.2,0.5,"x, y"\n12.5,134.25,-0.5,z\n',
    "comment": "# test 7\n# Time,Force,Ext\n12.4,134.2,0.5\n12.5,134.25,-0.5\n",
    "told": "sep=;\nTime;Force;Ext\n12,4;134,2;0,5\n12,5;134,25;-0,5\n",
    "units below": "Time;Force;Ext\ns;N;mm\n12,4;134,2;0,5\n12,5;134,25;-0,5\n",
    "units behind commas": "Time, s;Force, N;Ext, mm\n12,4;134,2;0,5\n12,5;134,25;-0,5\n",
    "separator at the end": "Time;Force;Ext\n12,4;134,2;0,5;\n12,5;134,25;-0,5;\n",
    "spelling": "TIME;force_;  e x t\n12,4;134,2;0,5\n12,5;134,25;-0,5\n",
    "text next to numbers": "Day;Force;Ext\n26.11.2026 12:00;134,2;0,5\n26.11.2026 12:01;134,25;-0,5\n",
    "minus sign": "Time;Force;Ext\n12,4;134,2;0,5\n12,5;134,25;\N{MINUS SIGN}0,5\n",
    "three digits, shown by another line": "Time;Force;Ext\n0,000;134,200;0,500\n0,100;134,250;-0,500\n",
}  # fmt: skip


@pytest.mark.parametrize("name", SAME)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_one_table_in_many_spellings_is_one_table(name: str, encoding: str) -> None:
    assert read(SAME[name].encode(encoding), "force", "ext")[1] == TRUTH


@pytest.mark.parametrize("head", ["Force (kN)", "Force [kN]", "Force / kN", "Force, kN", "Force;Time\nkN;s"])
def test_units_are_read_from_the_head(head: str) -> None:
    layout, rows = read(f"{head if 'Time' in head else head + ';Time'}\n1,5;2,5\n", "force")
    assert layout.columns[0].unit == "kN"
    assert layout.columns[0].name == "Force"
    assert rows == [[1.5]]


@pytest.mark.parametrize("lost", ["", "nan", "-nan(ind)", "NaN", "#N/A", "1.#QNAN", "--", "#NV"])
def test_a_lost_value_is_no_number(lost: str) -> None:
    (row,) = read(f"a;b\n{lost};0.5\n", "a", "b")[1]
    assert math.isnan(row[0])
    assert row[1] == 0.5


COMMAS = "line 2: has 6 cells under 3 names: the numbers seem to have decimal commas"
REFUSED = {
    "decimal commas between commas": (("Time,Force,Ext\n12,4,134,2,0,5\n", "Force"), COMMAS),
    "by number": (("Time,Force,Ext\n12,4,134,2,0,5\n", 2), COMMAS),
    "without names": (("12,4,134,2,0,5\n", 2), "line 1: may mean '4' and '134', or '4,134'"),
    "units behind commas": (("Time, s,Force, N\n12,4,134,2\n", "Force"), "line 2: may mean '134' and '2', or '134,2'"),
    "given comma": (("sep=,\nTime,Force\n12,4,134,2\n", 2), "line 3: has 4 cells under 2 names"),
    "a cell lost": (("a;b;c\n1;2;3\n1;2\n", "a"), "line 3: has 2 cells under 3 names, separated by semicolons"),
    "a cell more": (("a;b;c\n1;2;3\n1;2;3;4\n", "a"), "line 3: has 4 cells under 3 names"),
    "two decimal signs": (("a;b\n1,5;2\n1.5;2\n", "a"), "line 3: both '1.5' and '1,5' are numbers"),
    "broken quotes": (('a,b\n"1,2\n', "a"), "line 2: its quotes are broken"),
    "missing": (("a;b\n1;2\n", "c"), "line 1: column c is missing"),
    "no text": (("a;b\n1;\0\n", "a"), "is not plain text"),
    "long line": (("a;b\n1;" + "2" * 100_001 + "\n", "a"), "its quotes are broken"),
    "empty": (("", "a"), "table: is empty"),
    "blank": (("\n ;; \n", "a"), "holds blank lines only"),
    "comments": (("# a;b\n", "a"), "holds comments only"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_an_undecidable_table_is_refused_with_the_reason(name: str) -> None:
    arguments, printed = REFUSED[name]
    with pytest.raises(BadInput, match=re.escape(printed)) as error:
        read(*arguments)
    assert str(error.value).startswith("table: ")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("cell", "both"), [("1.500", "1.500 or 1500"), ("1,500", "1.500 or 1500"), ("-12,345", "-12.345 or -12345")])
def test_one_sign_before_three_digits_is_refused_with_both_readings_unless_it_is_reported(cell: str, both: str) -> None:
    with pytest.raises(AmbiguousTable, match=re.escape(f"{cell!r} may mean {both}; specify the decimal sign")):
        read(f"a;b\n{cell};7\n", "a")
    assert read(f"a;b\n{cell};7\n", "a", given=Convention(decimal="," if "," in cell else "."))[1] == [[float(cell.replace(",", "."))]]


@pytest.mark.parametrize("cell", ["1,234.5", "1.234,5", "1,234,567", "1'234.5", "1 234", "1_000", "0x10", "\u0663", "1e", "1,2,3"])
def test_thousands_and_other_texts_are_no_numbers(cell: str) -> None:
    assert number_in(cell, ".") is None
    assert number_in(cell, ",") is None
    assert number_in(cell, "") is None


def test_a_decimal_sign_that_the_head_has_not_shown_is_taken_from_the_first_line_that_does() -> None:
    layout, _ = read("a;b\n0;0\n", "a")
    assert layout.decimal == ""
    assert number_in("1,500", layout.decimal) is None
    layout = layout.after(layout.cells("0,5;1"))
    assert layout.decimal == ","
    assert number_in("1,500", layout.decimal) == 1.5
    assert number_in("1.5", layout.decimal) is None


def test_a_description_above_the_names_is_passed_over() -> None:
    text = "Test;7\nOperator: A, B\n\nTime;Force\ns;kN\n0,5;134,2\n"
    layout, rows = read(text, "Force", searched=200)
    assert (layout.head_line, layout.first_line, layout.columns[1].unit) == (4, 6, "kN")
    assert rows == [[134.2]]


def test_text_between_names_and_numbers_does_not_resolve_an_ambiguous_comma() -> None:
    """A single column with decimal commas was read as two columns: `Kraft, s` was taken for units."""
    text = "Rate: 0,5 mm/min\nKraft, s\n9643,179\n15343,259\n"
    with pytest.raises(AmbiguousTable, match=r"line 3: may mean .9643. and .179., or .9643,179."):
        read(text, 1, searched=200)
    assert read(text.replace("Kraft, s", "Kraft"), "Kraft", given=Convention(decimal=","), searched=200)[1] == [[9643.179], [15343.259]]


def test_a_blank_that_groups_digits_is_no_separator() -> None:
    layout = layout_of(["92.90,477 171.76", "-10.76,220 719.79"], "load.txt", lambda _: (1,))
    assert (layout.separator, layout.decimal) == (",", ".")


@pytest.mark.parametrize(
    ("text", "column", "message"),
    [
        # A text and a lost value are no names, and an empty cell of them gets no further empty cell.
        ("running,-nan(ind),\nrunning,-6,462e-02,\n", 2, "has 4 cells under 3"),
        ("running,,\nrunning,-6,462e-02,\n", 2, "has 4 cells under 3"),
        # A decimal comma in a title is no separator of names; the line below is a name and its unit.
        ("Rate: 0,5 mm/min\nv, px\n1302,10430\n", 1, "may mean '1302' and '10430', or '1302,10430'"),
        # An incomplete line below names that are separated otherwise is no single column.
        ('Tensile test 7\nx_1,Force,Ext\n"799,23"\n', 1, "1 cells under 3"),
        ("# Ext,Time\n-2620,265843\n-586,121983\n2676\n", 1, "has 1 cells under 2"),
        ("# Ext / s;x_1 / kN;Strain / %\n0\n", 1, "1 cells under 3"),
        ("Kraft  u  Remark  Weg\nkN  N    s\n4383  2,215e+03  12:03:44\n", 2, "3 cells under 4"),
        # Three numbers with commas between thousands are as many cells as six names.
        ("Load cell,Strain,Ext,Time,v,u\n34,538.58,3,025.80,2,016.53\n", "u", "34 and 538.58 may be one number"),
        # A single blank groups digits in an incomplete line of a table whose cells are two blanks apart.
        ("Time (s)  Force (N)\n-851.469  0.004\n5 269.966\n510.42  -0.08\n", "Time", "line 3: may mean '5' and '269.966', or '5 269.966'"),
        ("a  b  c\n0.5  1.5  2\n0.5  -1 234.5\n", "a", "line 3: may mean '-1' and '234.5'"),
        # The commas of a comment precede units: six names above seven cells.
        ("! Strain, px Force, MPa Kraft, N Time, mm u, um v, s\n0.5 493 -12863 1 24 96 0.5\n", 2, "has 7 cells under 6 names"),
        # An apostrophe between thousands makes no name of a number.
        ('Rate: 0,5 mm/min\n"Kraft";"Force"\n"42\'581";"1\'752";"42\'581"\n"7\'929";"2,395e+01";"7\'929"\n', 2, "has 3 cells"),
        # Two commas in a number between blanks are separators.
        ("14,49904,820,67544,4 061,01168\n24,56847,341,347,3 716,0144\n", 2, "may mean"),
        ("4,4 061\n-3,2 116\n", 2, "may mean '4' and '4 061', or '4,4 061'"),
        # The second value of a line with decimal commas may be lost.
        ("u / px,Weg / mm\n24,63,\n", "u", "may mean '24' and '63', or '24,63'"),
        # A number with thousands and a lost last value are as many cells as five names, of which the last is empty.
        ("Ext, u, Kraft, Strain\n297,129.194, 2.882, #N/A, \n", "Ext", "has 5 cells under 4 names"),
        # Names and numbers with different separators.
        ("# x y u v\n1.5,2,0.1,0.2\n", "u", "line 2: has commas between the numbers, but blanks between the names"),
        ("x,y,u,v\n1.5;2;0.1;0.2\n", "u", "line 2: has semicolons between the numbers, but commas between the names"),
        # A description above a table that is not written yet, also if a text repeats.
        ("Time;0.5\n", 2, "may be the description of a test"),
        ("Time;0.5\nTime;1.5\nForce;3.5\n", 2, "may be the description of a test"),
        ("Speed;0.5;mm/min\nSpeed;0.7;mm/min\n", 2, "is no line of names"),
        # A sign apart from its number is no lost value.
        ("0 - 1.5\n1 - 2.5\n", 3, "may mean '-' and '1.5', or '- 1.5'"),
        ("Time,Force\n1,-2,788e+01\n", "Force", "has 3 cells"),
        ("Time,Force\n-2,788e+01\n", "Force", "may mean '-2' and '788e.01', or '-2,788e.01'"),
    ],
)
def test_what_may_be_another_number_is_refused(text: str, column: str | int, message: str) -> None:
    """Each of these was read as another number than the one written."""
    with pytest.raises(BadInput, match=message):
        read(text, column, searched=200)


@pytest.mark.parametrize("cells", ["1 2 3 4 5", "1 2 3"])
def test_a_single_line_with_more_or_fewer_cells_than_names_above_it_is_refused(cells: str) -> None:
    """Three equal lines show that the text above is a title, unless these state a unit."""
    with pytest.raises(BadInput, match=r"has . cells under 4 names"):
        read(f"# u v Force Strain\n{cells}\n", 1)
    assert read(f"# u v Force Strain\n{cells}\n{cells}\n{cells}\n", 1)[1] == [[1.0]] * 3
    with pytest.raises(BadInput, match=r"has . cells under 4 names"):
        read(f"# u v Force (kN) Strain\n{cells}\n{cells}\n{cells}\n", 1)


def test_blanks_that_may_group_digits_are_no_separator() -> None:
    with pytest.raises(BadInput, match="its blanks may group digits between commas"):
        read("! Kraft, px,u, um\n0,5 994\n", "Kraft")
    with pytest.raises(BadInput):
        read('Tensile test 7\n"Weg";"Force";"Kraft"\n"0,01";"-148 866,28";"-17,3"\n"-0,01";"208 347,95"\n', 1, searched=5)


@pytest.mark.parametrize("line", ['"";"-9926";"--";""', ";-9926;--;", '"7";"-9926";"3";""'])
def test_an_empty_cell_at_the_end_of_one_line_is_a_cell_unless_it_is_unquoted_and_no_value_is_lost(line: str) -> None:
    with pytest.raises(BadInput, match="has 4 cells under 3 names"):
        read(f"Time;Force;Ext\n{line}\n", 2)
    assert read("Time;Force;Ext\n7;-9926;3;\n", 2)[1] == [[-9926.0]]


@pytest.mark.parametrize(
    "head", ["% Time Force", "! Time Force", "% Time, Force", "// Time;Force", "# Time | Force", "|Time|Force|", "%% test\n% Time Force"]
)
def test_names_in_comments_of_other_programs_are_read(head: str) -> None:
    assert read(f"{head}\n0.1 134.2\n 0.2 0.1343D+03\n", "Force")[1] == [[134.2], [134.3]]


@pytest.mark.parametrize(
    "head",
    ["# Time Force\n# s kN", "% Time, s  Force, kN", "# Time, s, Force, kN", "# Time (s) | Force (kN)", "s kN", "% Time / s Force / kN"],
)
def test_units_in_comments_and_without_names_are_read(head: str) -> None:
    layout, rows = read(f"{head}\n0.1 0.134\n", 2)
    assert (layout.columns[1].unit, rows) == ("kN", [[0.134]])


@pytest.mark.parametrize("text", ["| Time | Force |\n|---|---|\n| 0.1 | 134.2 |\n", "0.1 | 134.2\n0.2 | 134.3\n"])
def test_bars_between_numbers_are_refused_by_name(text: str) -> None:
    with pytest.raises(BadInput, match=r"is separated by '\|'"):
        read(text, 2)
    assert read("Time|Force\n0.1|134.2\n", "Force", given=Convention(separator="|"))[1] == [[134.2]]


def test_empty_comments_that_labview_omits_are_accepted() -> None:
    assert read("X_Value\tForce\tComment\n0,0\t134,2\n0,1\t134,3\n", "Force")[1] == [[134.2], [134.3]]


def test_a_description_without_a_table_below_it_contains_no_numbers() -> None:
    """Its last value was read as the load until the first line of numbers was written."""
    description = "Specimen;7\nRate;2\n"
    with pytest.raises(AmbiguousTable, match="line 1: may be the description of a test"):
        read(description, 2, searched=200)
    assert read("OK;7\nOK;2\nOK;3\n", 2)[1] == [[7.0], [2.0], [3.0]]
    assert read("Remark;Force\nOK;7\n", "Force")[1] == [[7.0]]


@pytest.mark.parametrize(
    "rows", ["1  99.12\n2 105.12", "  1  99.12\n 12 105.12", "1    99.12\n105  105.12\n7   100.12", "1  99.12\n2 -105.12"]
)
def test_a_single_blank_between_columns_of_fixed_width_is_a_separator(rows: str) -> None:
    assert [abs(row[0]) for row in read(f"n Force\n{rows}\n", "Force")[1]][:2] == [99.12, 105.12]


def test_the_same_single_blank_between_all_cells_is_a_separator() -> None:
    assert read("n Force\n0.5 99.12\n5 269.966\n", "Force")[1] == [[99.12], [269.966]]
