"""Units of devices, as factors to N, mm, s and strain."""

from __future__ import annotations

import re

from semlive.errors import BadConfig

FACTORS = {
    "1": 1.0,
    "N": 1.0,
    "kN": 1e3,
    "mN": 1e-3,
    "uN": 1e-6,
    "daN": 10.0,
    "kg": 9.80665,
    "g": 9.80665e-3,
    "t": 9.80665e3,
    "lbF": 4.4482216152605,
    "mm": 1.0,
    "um": 1e-3,
    "m": 1e3,
    "in": 25.4,
    "s": 1.0,
    "ms": 1e-3,
    "mm/s": 1.0,
    "um/s": 1e-3,
    "mm/min": 1.0 / 60.0,
    "in/min": 25.4 / 60.0,
    "N/s": 1.0,
    "N/min": 1.0 / 60.0,
    "ustrain": 1e-6,
    "%": 1e-2,
}
"""N, mm, s, mm/s, N/s or strain of one unit; kg, g, t and lbF are forces."""
_ALIASES = {name.lower(): name for name in FACTORS} | {
    "lb": "lbF",
    "lbs": "lbF",
    "kgf": "kg",
    "gf": "g",
    "kp": "kg",
    "lbs-f": "lbF",
    "lb-f": "lbF",
    **dict.fromkeys(("n", "newton", "newtons", "н"), "N"),
    **dict.fromkeys(("kilonewton", "kilonewtons", "кн"), "kN"),
    **dict.fromkeys(("millinewton", "millinewtons"), "mN"),
    **dict.fromkeys(("inch", "inches"), "in"),
    **dict.fromkeys(("millimeter", "millimeters", "millimetre", "millimetres", "мм", "毫米"), "mm"),
    **dict.fromkeys(("micrometer", "micrometers", "micrometre", "micrometres", "microns", "мкм", "微米"), "um"),
    **dict.fromkeys(("percent", "pct"), "%"),
    **dict.fromkeys(("um/m", "µm/m", "μm/m", "ppm"), "ustrain"),
    **dict.fromkeys(("mm/mm", "m/m", "in/in", "-"), "1"),
}


def factor(unit: str, where: str) -> float:
    """N, mm, s, mm/s, N/s or strain of one unit.

    Args:
        unit: name of the unit. Letter case counts only where two units differ by it; mN is known, MN is not.
        where: name of the setting in an error.

    Raises:
        BadConfig: if the unit is unknown.
    """
    name = unit if unit in FACTORS else _ALIASES.get(unit.lower(), "")
    if not name:
        raise BadConfig(f"{where}: unit {unit!r} is not known; it may be {', '.join(FACTORS)}")
    return FACTORS[name]


_MICRO = re.compile(r"(?:[^\x00-\x7f]{1,3}|u)(m|n|e|ε|strain)|micro(n|strain)", re.IGNORECASE)
"""A micro sign of any code page: no other prefix of these units is outside ASCII."""


def unit_named(text: str) -> str:
    """The unit in the head of a file, as in `FACTORS`; empty if it is unknown or ambiguous."""
    if text in FACTORS:
        return text
    lower = text.casefold()
    # MN is not mN, and a capital M, G or T is no metre, gram or tonne.
    if lower == "mn" or (len(text) == 1 and text not in "nН-"):
        return ""
    micro = _MICRO.fullmatch(lower)
    if micro is not None:
        return {"m": "um", "n": "uN"}.get(micro[1], "um" if micro[2] == "n" else "ustrain")
    return _ALIASES.get(lower, "")


_WORDS = re.compile(r"%|[^\W\d_]+")
_JOINED = re.compile(r".*[a-z](kN|mN|daN|MN)")


def unit_in_name(name: str) -> str:
    """A unit that may be a part of the name of a column: ``Ext_in``, ``Force-kN``, ``kN Force``, ``ForcekN``; empty without one.

    A single letter and ``in`` may be a unit at the end only.
    """
    words, joined = _WORDS.findall(name), _JOINED.fullmatch(name)
    candidates = [joined[1]] if joined else []
    candidates += [word for word in words if word == "%" or (len(word) > 1 and word != "in")]
    candidates += words[1:][-1:]
    return next((word for word in candidates if word.casefold() == "mn" or unit_named(word)), "")
