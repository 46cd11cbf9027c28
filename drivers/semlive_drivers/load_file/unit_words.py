"""Terms that state another unit than N, mm or strain in the name of a column, or in the lines above a table.

A legend such as ``Channel 2 Force kN`` or ``Ch1: Load [x10 N]`` is text above the names. A column without a unit below it is refused,
because 10 kN read as 10 N would be below every limit. A quantity (``Load cell 5 kN``), a rate (``kN/s``) and a part of a longer term
(``kN-steel``) are no units of a column.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from functools import lru_cache

_FORCES = (
    r"(?i:k\s?n|kilo[ -]?newtons?\w*|(?:mega|milli|micro|nano|deca|deka|centi)newtons?\w*"
    r"|kp|kilo-?ponds?|ponds?|kgf?|kg-f|kgp|gf|tonf|ton-force"
    r"|tonn?es?|tons?|lb[sf]?|lbs?-f|pounds?|pounds?-force|klb[sf]?|kips?|ozf?|ounces?|dynes?|кн|мн|кгс?|тс|дан)"
    r"|[mM]\s?N|mn|[uμ]N|nN|cN|hN|da\s?N|tf|dyn"
)
_EAST_ASIAN_FORCES = re.compile("千牛|千克|公斤|吨|兆牛|毫牛|(?:キロ|ミリ|メガ)ニュートン|キログラム|킬로뉴턴")
_LENGTHS = (
    r"(?i:[uμ]m|мкм|nm|cm|mils?|inch(?:es)?|zoll|microns?|mi[kc]romet(?:er|re)s?|nanomet(?:er|re)s?"
    r"|[uμ]strain|[uμ]ε|[uμ]e|microstrain|strain"
    r"|mm/mm|m/m|pixels?|px|微米|厘米)"
)
_STRAINS = r"(?i:[uμ]strain|[uμ]ε|[uμ]e|[uμ]m/m|microstrains?|millistrain|ppm|[uμ]D|mm/m(?!m))"
_SIGNALS = (
    r"(?i:[mμu]v/v|[mμ]?v|volts?|millivolts?|ma|ohms?|ω|counts?|cts|raw(?:[ -]?(?:data|value|values))?|adc|bits?|digits?|lsb|%\s?fs|%|‰"
    r"|percent|per cent|pct|prozent|per ?mille|pro ?mille|permil|fs|full scale|normali[sz]ed|normiert|rohwerte?|roh)"
)
_UNITS = {
    "force": rf"{_FORCES}|{_SIGNALS}",
    "extension": rf"{_LENGTHS}|{_SIGNALS}",
    "gage": _STRAINS + r"|(?i:[mμu]v/v|[mμ]?v|volts?|counts?|raw|adc|%|‰)",
}
_WORDS = {
    "force": "force|load|kraft|last|f|p|力|荷重|载荷|負荷|試験力|하중|힘"
    "|сила|усилие|нагрузка|fuerza|carga|forza|carico|effort|charge|força|kracht",
    "extension": "ext|extension|elongation|displacement|stroke|weg|verlängerung|position|crosshead|travel"
    "|伸び|变形|位移|変位|ход|déplacement",
    "gage": "strain|gage|gauge|dehnung|dms|ひずみ|应变|deformation",
}
_DEFAULTS = {"force": r"n|newtons?|н", "extension": "mm|мм|millimet(?:er|re)s?", "gage": "1|-"}
_BEGIN, _END = r"(?<![^\W_\d])", r"(?![^\W_\d])(?!/(?:s|sec|min|h|mm\^?2|m\^?2)(?![^\W_]))(?!-[^\W\d_])"
_FACTOR = (
    r"(?:[*×·⋅÷]|(?<![\d/])/|(?<![^\W_])x)\s*\(?[-+]?\d[\d.,]*(?:e[-+]?\d+)?|10\s*(?:\^|\*\*)\s*\(?[-+]?\d+"
    r"|(?<![^\W_\d])\d*[.,]?\d*e[-+]?\d{1,2}(?!\w)|\de[-+]?\d{1,2}(?=\s?n)|(?<![^\W_])\d+\s*x(?![^\W_])"
    r"|(?<![^\W_])(?:thousands?|hundreds?|tausend|kilo|mega|milli|mille)(?![^\W_])"
)
_FACTOR_END = r"(?![\d/\\])"
_POWER_OF_TEN = r"(?<![\d.,])(?:10+|0?[.,]0*1)\s*_?n(?![^\W_])"
_NAMED_FACTOR = re.compile(f"{_FACTOR}|{_POWER_OF_TEN}|(?<=[a-z])\\d+e[-+]?\\d+", re.IGNORECASE)
_NOT_ONE = r"(?!1(?:[.,]0*)?(?!\d))\d[\d.,]*"
_SCALE_WORD = r"(?:scale|scaling|factor|faktor|multiplier|gain|skalierung)(?![^\W_])"
_SCALE = rf"(?<![^\W_]){_SCALE_WORD}\D{{0,12}}{_NOT_ONE}"
_IN = r"(?:(?i:in|units?|einheit)\W+)?"
_CHANNEL = r"(?:ch|chan|channel|col|column|kanal|spalte|signal|input|sensor|voie|canal|no|nr|#)"
_NUMBER_BEFORE = re.compile(r"(.*?)(?<![\w.,])[-+]?\d[\d.,']*(?:e[-+]?\d+)?\s*[-_]?\s*$", re.IGNORECASE | re.DOTALL)
_NUMBER_JOINED = re.compile(r".*[^\W\d_]\d+\s*$")
_QUALIFIER = re.compile(
    r"max|min(?:imum)?\b|pre|vor|nominal|nenn|rated|peak|limit|grenz|target|ziel|soll|start|end|capacity|range", re.IGNORECASE
)
_DEVICE = re.compile(r"\W*(?:load|cell|frame|machine|sensor|stage|tester|maschine|kraft|range|capacity|max)", re.IGNORECASE)
_SCRIPT_CHANGE = re.compile(r"(?<=[\u3040-\u9fff\uac00-\ud7a3])(?=[A-Za-zμ])|(?<=[A-Za-zμ])(?=[\u3040-\u9fff\uac00-\ud7a3])")
_SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+")
_SUPERSCRIPT = re.compile("[⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺]+")
_JOINED = re.compile(r".*[A-Za-z](kN|mN|daN|MN|klbf|lbf|kgf|KN)(?![A-Za-z])")
_JOINED_WORD = re.compile(r"(?:.*[\W_])?(?:force|load|kraft|last|f)(kn|mn|dan|lbf|kgf)", re.IGNORECASE)


def _plain(text: str) -> str:
    """Return text with one kind of micro sign, powers as ``^3``, and a blank between letters of Latin and of East Asian scripts."""
    powers = _SUPERSCRIPT.sub(lambda match: "^" + match[0].translate(_SUPERSCRIPTS), text)
    return _SCRIPT_CHANGE.sub(" ", unicodedata.normalize("NFKC", powers))


@lru_cache(256)
def other_in_name(kind: str, name: str) -> str:
    """Return a unit or factor in the name of a column by which its numbers may have another unit; empty without one.

    Args:
        kind: force, extension or gage.
        name: as written in the head; a unit in brackets included.
    """
    plain = _plain(name)
    factor = factor_in_name(name) if kind != "gage" else ""
    if factor:
        return factor
    words = (match[0] for match in re.finditer(f"{_BEGIN}(?:{_UNITS[kind]}){_END}", plain) if match.start() or kind != "extension")
    word = next(words, "")
    if word or kind != "force":
        return word
    found = _EAST_ASIAN_FORCES.search(plain) or _JOINED.match(plain) or _JOINED_WORD.fullmatch(plain)
    return found[found.lastindex or 0] if found else ""


def factor_in_name(name: str) -> str:
    """Return a factor in the name of a column, such as ``x10``, ``/10N`` or ``10^3``; empty without one."""
    factor = _NAMED_FACTOR.search(_plain(name))
    return "" if factor is None else factor[0].strip()


def is_unit_or_factor(kind: str, name: str) -> bool:
    """Whether the name of a column is only a unit or a factor, as in ``Force x1000 N`` that is split at blanks."""
    return re.fullmatch(rf"[\[(]?(?:(?i:{_FACTOR}|scale|factor)|{_UNITS[kind]})[\])]?", _plain(name)) is not None


def other_in_titles(kind: str, own: Sequence[str], number: int, titles: Sequence[tuple[int, str]]) -> tuple[int, str]:
    """Return the line above a table, and its unit or factor, by which a column may have another unit; 0 and an empty text without one.

    Args:
        kind: force, extension or gage.
        own: names of the column.
        number: its number, from 1.
        titles: numbers and texts of the lines.
    """
    for line, text in titles:
        word = _other_in_title(kind, tuple(own), number, text)
        if word:
            return line, word
    return 0, ""


@lru_cache(1024)
def _other_in_title(kind: str, own: tuple[str, ...], number: int, text: str) -> str:
    plain, name = _plain(text), _name_pattern(kind, own)
    factor = factor_in_text(kind, own, text)
    if factor:
        return factor
    if re.search(rf"{name}[\W_]*{_IN}(?i:{_DEFAULTS[kind]}){_END}", plain):
        return ""
    units, not_behind_number = (
        rf"((?:{_UNITS[kind]}){'|[gt]|(?i:gramm?s?)' if kind == 'force' else ''}){_END}",
        r"(?<![^\W_])(?<!\d)(?<!\d\s)",
    )
    channel = rf"(?<![^\W_])(?i:{_CHANNEL})\W*0*{number}(?!\d)|^\W*0*{number}\s*[:=.)]"
    for before in (rf"{name}[\W_]*{_IN}", rf"(?:{channel})[^;]*?{not_behind_number}"):
        match = re.search(before + units, plain)
        if match is not None:
            return match[1]
    match = re.search(rf"{not_behind_number}{units}\s+(?:of\s+)?(?:the\s+)?{name}", plain)
    if match is not None and "data" not in match[1].casefold():
        return match[1]
    found = _EAST_ASIAN_FORCES.search(plain) if kind == "force" else None
    return found[0] if found else _force_in_title(name, plain) if kind == "force" else ""


def _name_pattern(kind: str, own: tuple[str, ...]) -> str:
    names = [re.escape(_plain(name)) for name in own if len(name) > 1 and not name.isdecimal()]
    return f"(?<![^\\W_])(?i:{'|'.join([*names, _WORDS[kind]])})(?![^\\W_])"


@lru_cache(1024)
def factor_in_text(kind: str, own: tuple[str, ...], text: str) -> str:
    """Return a factor next to N or to the name of a column: ``Force x10``, ``10^3 N``, ``Force (10 N)``, ``force scale: 1000``."""
    if kind == "gage":
        return ""
    plain, name = _plain(text), _name_pattern(kind, own)
    factor, default = f"(?i:{_FACTOR}){_FACTOR_END}", rf"(?i:{_DEFAULTS[kind]}){_END}"
    patterns = (
        rf"{factor}[\s\])]*{default}",
        rf"(?<![^\W_]){default}[\])]?\s*{factor}",
        rf"{name}(?:[\W_]*{_IN}{default})?[\W_]*{factor}",
        rf"{name}.*(?i:{_SCALE})",
        rf"(?<![^\W_])(?i:{_SCALE_WORD}).*{name}\D{{0,12}}{_NOT_ONE}",
        rf"(?<![^\W_]){default}\s*/\s*10+(?!\d)",
    )
    for pattern in patterns:
        match = re.search(pattern, plain)
        if match is not None:
            return match[0].strip()
    match = re.search(rf"{name}\W*((?i:{_POWER_OF_TEN}))", plain) if kind == "force" else None
    return match[1] if match is not None and not _QUALIFIER.search(plain[: match.start()]) else ""


def _force_in_title(name: str, text: str) -> str:
    """Return a unit of force that is no quantity, as ``Load cell 5 kN`` is."""
    for match in re.finditer(f"{_BEGIN}(?:{_FORCES}){_END}", text):
        before, after = text[: match.start()], text[match.end() :]
        number = _NUMBER_BEFORE.fullmatch(before)
        if number is None:
            if _NUMBER_JOINED.fullmatch(before) and not re.search(rf"{_CHANNEL}\d+\s*$", before, re.IGNORECASE):
                continue  # X2 kN-steel, RF5kN
            return match[0]
        lead = number[1].rstrip(" :=([\t,;#%!/")
        if not re.search(r"\w", lead):
            if _DEVICE.match(after):
                continue
            return match[0]
        if re.search(rf"(?<![^\W_]){_CHANNEL}$", lead, re.IGNORECASE) or re.search(r"[*×·^]$|(?<![^\W_])x$", lead, re.IGNORECASE):
            return match[0]
        if re.search(rf"{name}$", lead, re.IGNORECASE) and not _QUALIFIER.search(lead):
            return match[0]
    return ""
