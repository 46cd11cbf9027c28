"""Safe display of external text (file names, replies of devices, headers) in a terminal or on a page."""

from __future__ import annotations

import unicodedata

# Control, format (bidirectional overrides among them), lone surrogate, private use, unassigned; line and paragraph separators.
_HIDDEN = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
_SHORT = {"\n": "\\n", "\r": "\\r", "\t": "\\t", "\x1b": "\\x1b"}


def printable(text: str, keep: str = "") -> str:
    r"""The text with every control character as an escape sequence such as ``\x1b``, ``\n`` or ``\u202e``.

    A terminal executes control characters: a file name could clear the screen, imitate a message of semlive, or hide a part of itself.

    Args:
        text: any text.
        keep: characters that are not escaped, such as a line break in a text of several lines.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(char if char in keep or unicodedata.category(char) not in _HIDDEN else _escaped(char) for char in text)


def _escaped(char: str) -> str:
    code = ord(char)
    return _SHORT.get(char) or (f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}")
