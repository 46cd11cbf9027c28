"""Split of the lines of a text table into cells, and of the cells of its head into names and units."""

from __future__ import annotations

import codecs
import csv
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from semlive.errors import BadInput
from semlive.inputs.text_number import SPREADSHEET_MARK, is_lost

LONGEST_LINE = 100_000
"""Characters."""
_MARKS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
SPREADSHEETS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""First bytes of XLSX (a ZIP archive) and XLS."""
_CONTROL = re.compile("[\x00-\x08\x0e-\x1f]")
_DECLARED = re.compile(r'"?sep=(.)"?', re.IGNORECASE)
TOKEN = re.compile(r'"(?:[^"]|"")*"|\S+')
"""A cell of a line that is split at blanks."""
_OTHER_BRACKETS = str.maketrans("【「『〔〈《⟨⟦«‹」】』〕〉》⟩⟧»›", "[" * 10 + "]" * 10)
_BRACKET = re.compile(r"(.*?)\s*[\[({<]\s*([^\[\](){}<>]*?)\s*[\])}>]")
_UNIT_TWICE = re.compile(r"([(\[](\w+)[)\]])\s*[(\[]\2[)\]]", re.IGNORECASE)
"""The same unit in two pairs of brackets, as Dantec DynamicStudio writes it: ``x (pix)[pix]``."""
_SLASH = re.compile(r"(.+?)\s+/\s+(\S+)")
_FINAL_UNIT = re.compile(
    r"(.+?)(?:\s*[_:/]\s*|\s+in\s+|\s+)"
    r"(n|kn|mn|un|µn|μn|nn|dan|kgf|lbf|kg|mm|um|µm|μm|nm|cm|s|sec|ms|us|µs|μs|ns|px|pixels?|mpa|gpa|m/s|mm/s|um/s|mm/min|n/s|n/min)",
    re.IGNORECASE,
)
"""A unit without brackets at the end of a name: ``force_kN``, ``Kraft in kN``, ``F/kN``; not ``Force min``, which may be a minimum."""
_AFTER_COMMA = re.compile(r"(.+?)\s*,\s*(\S+)")
_UNIT_WORDS = """
n kn mn µn un nn dan kg g t lbf lb lbs kgf gf newton nm um µm μm mm cm m in inch s sec secs second seconds ms us min h hz v mv %
ustrain 1 - px pixel pixels pix
mpa gpa pa °c c deg ° mm/s um/s µm/s n/s mm/min n/min
"""
_UNITS = frozenset(_UNIT_WORDS.split())
_STATED_UNIT = re.compile(r"[\[(,/_]\s*([^\s\[(),;/_\]]+)(?=[\s\]),;]|$)")
_UNITS_OF_READINGS = frozenset(("n", "kn", "mn", "µn", "un", "nn", "dan", "kgf", "lbf", "kg", "um", "µm", "μm", "mm", "nm", "%", "ustrain"))
"""Units that state what a column without another name contains."""
_VALUES_IN = r"(?:values|data|displacements?|positions?|coordinates?|loads?|forces?)\s+(?:are\s+)?in"
_UNIT_WORD = r"(?:units?|einheit(?:en)?|unit[ée]s?|unidad(?:es)?|unità|単位|单位)(?:[_ ]labels?)?"
_TITLE_UNITS = re.compile(rf"(?:^|[\W_])(?:{_VALUES_IN}|{_UNIT_WORD})" + r"((?:[\s\"':=;,()\[\]]+[^\s\"':=;,()\[\]]+)+)", re.IGNORECASE)
_NAME_AND_UNIT = re.compile(r"(\w+)\s*[\[({<]\s*([^\s\[\](){}<>]+)\s*[\])}>]")
_NAMES_AS_WELL = frozenset(("t", "v", "c", "h"))
_COMMENT = re.compile(rf"\s*(?!{SPREADSHEET_MARK}|#{{2,}}\s*[;,\t])#", re.IGNORECASE)
"""A line that begins with an error value of a spreadsheet is no comment: the line before it would remain the newest one."""
_HEAD_COMMENT = re.compile(r"\s*(?:%(?!\s*(?:[;,\t\])]|$))|!|\||//)")
"""Other signs of comments, which are accepted above the numbers only; ``%;N`` is a line of units."""
_DECIMAL_COMMA = re.compile(r"[0-9],[0-9]")
_QUOTED = re.compile(r'"(?:[^"]|"")*"')
_DECORATION = re.compile(r"[\W_]*")
_BEGINS_WITH_DIGIT = re.compile(r"\W*[0-9]")
_NUMERIC = re.compile(r"[-+0-9.,'\u2019eEdD\s]*[0-9][-+0-9.,'\u2019eEdD\s]*")


@dataclass(frozen=True, slots=True)
class Column:
    """One name of the head.

    Attributes:
        raw: as written; empty in a table without names.
        name: without its unit.
        unit: from brackets after the name, after a slash, or from a line of units; empty without one.
        title_units: numbers and units of lines above the names that state units, such as ``Units: kN``, for a column without a unit.
        titles: numbers and texts of the lines above the first line of numbers, without the lines of names and units.
    """

    raw: str
    name: str
    unit: str
    title_units: tuple[tuple[int, str], ...] = ()
    titles: tuple[tuple[int, str], ...] = ()

    @property
    def key(self) -> str:
        """The name for comparisons, which ignore letter case, blanks, hyphens and underscores."""
        return key_of(self.name)


def text_of(data: bytes, where: str, encoding: str = "utf-8") -> str:
    """Decode the text of a table by its byte order mark, or else by the given encoding.

    Raises:
        BadInput: the data are not plain text.
    """
    if data.startswith(SPREADSHEETS):
        raise BadInput(f"{where}: is a spreadsheet, no plain text; save it as CSV.")
    start, encoding = encoding_of(data, encoding)
    try:
        text = decoded(data[start:], encoding, "strict")
    except UnicodeDecodeError as error:
        raise BadInput(f"{where}: is not plain text (byte {start + error.start}); export the table as CSV in UTF-8.") from error
    text = text.rstrip("\x1a")  # end of file of DOS programs
    control = _CONTROL.search(text)
    if control is not None:
        raise BadInput(f"{where}: is not plain text (it holds the character {ord(control[0])}); export the table as CSV in UTF-8.")
    return text


def decoded(data: bytes, encoding: str, errors: str = "replace") -> str:
    """Decode text; what is not UTF-8 is decoded in the western code page of Windows.

    Digits, signs and separators have the same bytes in all code pages of Windows, so another code page changes names and remarks only.

    Args:
        data: bytes of the text.
        encoding: its encoding; ``utf-8`` includes the western code page.
        errors: ``replace`` or ``strict``, for other encodings.

    Raises:
        UnicodeDecodeError: the data are invalid and `errors` is ``strict``.
    """
    if encoding == "utf-8":
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            return data.decode("cp1252", errors="replace")
    return data.decode(encoding, errors=errors)


def encoding_of(data: bytes, encoding: str = "utf-8") -> tuple[int, str]:
    """Return the length of the byte order mark at the beginning of a file and the encoding of the file.

    Without a mark, UTF-16 is detected by zero bytes in the first two characters; otherwise it is the given encoding.
    """
    for mark, name in _MARKS:
        if data.startswith(mark):
            return len(mark), name
    zeros = [byte == 0 for byte in data[:4]]
    if zeros == [False, True, False, True]:
        return 0, "utf-16-le"
    if zeros == [True, False, True, False]:
        return 0, "utf-16-be"
    return 0, encoding


def lines_of(text: str) -> list[str]:
    """Return the lines without their ends; only line feeds and carriage returns end a line."""
    if "\n" not in text:
        text = text.replace("\r", "\n")  # old Macintosh programs
    return [line.removesuffix("\r") for line in text.split("\n")]


@lru_cache(4096)
def key_of(name: str) -> str:
    """Return a name for comparisons."""
    return re.sub(r"[\s_-]+", "", name).casefold()


def split(line: str, separator: str) -> list[str]:
    """Return the cells of a line, without quotes and the blanks around them.

    Raises:
        ValueError: the quotes are broken.
    """
    if separator == " ":
        return [cell[1:-1].replace('""', '"').strip() if cell.startswith('"') and len(cell) > 1 else cell for cell in TOKEN.findall(line)]
    if '"' not in line or len(separator) > 1:
        return [cell.strip() for cell in line.split(separator)]
    try:
        (cells,) = csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True)
    except csv.Error as error:
        raise ValueError(str(error)) from error
    return [cell.strip() for cell in cells]


def separator_declared(line: str) -> str:
    """Return the separator in a ``sep=;`` line, which spreadsheets write; empty for other lines."""
    match = _DECLARED.fullmatch(line.strip(" \ufeff"))
    return "" if match is None else match[1]


def is_remark(line: str) -> bool:
    """Whether a line above the names does not belong to the table: a comment, or a ``sep=`` line."""
    return line.startswith("***") or is_head_comment(line) or separator_declared(line) != ""


def is_blank(line: str) -> bool:
    """Whether a line contains no values: it is empty, a comment, or a row of empty cells from a spreadsheet."""
    return not line.strip(" \t;,\r") or is_comment(line)


def is_comment(line: str) -> bool:
    """Whether a line begins with ``#``, except for ``#N/A`` of spreadsheets."""
    return _COMMENT.match(line) is not None


def is_head_comment(line: str) -> bool:
    """Whether a line above the numbers is a comment, also as MATLAB (``%``), Fortran (``!``) and others mark it."""
    return is_comment(line) or (_HEAD_COMMENT.match(line) is not None and not all(map(is_no_name, line.split())))


def is_decoration(line: str) -> bool:
    """Whether a line contains neither letters nor digits."""
    return _DECORATION.fullmatch(line) is not None


def comment_text(line: str) -> str:
    """Return a comment without its sign."""
    return line.strip().lstrip("#%!/").strip()


def is_unit(cell: str) -> bool:
    """Whether a cell is a unit without a name."""
    return cell.strip("[]() ").casefold() in _UNITS


def states_unit(line: str) -> bool:
    """Whether a line contains a unit of force, length or strain in brackets or after a slash, a comma or an underscore."""
    return any(match[1].casefold() in _UNITS_OF_READINGS for match in _STATED_UNIT.finditer(line))


@lru_cache(256)
def units_stated(line: str) -> tuple[tuple[str, str], ...]:
    """Return units of force, length or strain and the keys of their columns.

    The key is empty for units behind ``unit`` or ``values in``: ``Units: kN, mm``, ``Force unit;kN``. ``Column 2: Force [kN]`` states the
    unit of the column ``force``.
    """
    match = _TITLE_UNITS.search(line)
    units = [("", word) for word in re.split(r"[\s\"':=;,()\[\]]+", match[1])] if match else []
    units += [(key_of(name), unit) for name, unit in _NAME_AND_UNIT.findall(line)]
    return tuple((key, unit) for key, unit in units if unit.casefold() in _UNITS_OF_READINGS)


def is_no_name(cell: str) -> bool:
    """Whether a cell of a line of names is a unit and cannot be the name of a column."""
    return is_unit(cell) and cell.casefold() not in _NAMES_AS_WELL


def is_line_of_units(cells: Sequence[str]) -> bool:
    """Whether a line below the names contains units: neither numbers nor marks of lost values, also if a unit is unknown.

    ``-``, ``1`` and ``n/a`` are units without a dimension if another cell is a unit.
    """
    filled = [cell for cell in cells if cell]
    named = [cell for cell in filled if cell.strip("[]() ") != "1" and not is_lost(cell.strip("[]() "))]
    if any(map(_BEGINS_WITH_DIGIT.match, named)):
        return False
    return bool(named) and (len(named) == len(filled) or any(map(is_no_name, named)))


def is_line_of_numbers(cells: Sequence[str]) -> bool:
    """Whether a line contains mainly numbers under some convention, so it is not a line of names."""
    filled = [cell for cell in cells if cell]
    if filled and all(map(is_lost, filled)):
        return True
    numeric = sum(_NUMERIC.fullmatch(cell) is not None for cell in filled)
    return numeric > 0 and len(filled) <= 2 * (numeric + sum(is_lost(cell) for cell in filled))


def is_no_line_of_names(cells: Sequence[str], line: str, separator: str) -> bool:
    """Whether a line contains a mark of lost values, as a line of numbers does, or a decimal comma between commas, as a title does."""
    if any(is_lost(cell) and any(map(str.isalpha, cell)) for cell in cells):
        return True
    return separator == "," and _DECIMAL_COMMA.search(_QUOTED.sub("", line)) is not None


def columns_of(names: Sequence[str], separator: str) -> tuple[Column, ...]:
    """Return the columns of a line of names."""
    return tuple(_column(name) for name in (joined_units(names) if separator == " " else names))


def joined_units(names: Sequence[str]) -> list[str]:
    """Join names and units such as ``Force (N)``, ``Force / N`` and ``Force, N`` in a line that is split at blanks."""
    joined: list[str] = []
    for name in names:
        if joined and (
            re.fullmatch(r"[\[(].*[\])]|/", name) or joined[-1].endswith(" /") or (joined[-1].endswith(",") and is_no_name(name))
        ):
            joined[-1] += f" {name}"
        else:
            joined.append(name)
    return joined


def _column(raw: str) -> Column:
    plain = _UNIT_TWICE.sub(
        r"\1", unicodedata.normalize("NFKC", raw).translate(_OTHER_BRACKETS)
    )  # brackets and wide letters of Chinese and Japanese texts
    if plain.strip("[]() ").casefold() in _UNITS_OF_READINGS:
        return Column(raw, raw, plain.strip("[]() "))
    for pattern in (_BRACKET, _SLASH, _AFTER_COMMA, _FINAL_UNIT):
        match = pattern.fullmatch(plain)
        if match is not None and match[1] and (pattern is not _AFTER_COMMA or is_unit(match[2])):
            return Column(raw, match[1].strip(), match[2].strip())
    return Column(raw, plain, "")
