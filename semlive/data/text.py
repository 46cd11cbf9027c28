"""Text from outside (file names, replies of devices, headers) made safe to show in a terminal or on a page."""

from __future__ import annotations

import unicodedata

# Control, format (bidirectional overrides among them), lone surrogate, private use, unassigned; line and paragraph separators.
_HIDDEN = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
_SHORT = {"\n": "\\n", "\r": "\\r", "\t": "\\t", "\x1b": "\\x1b"}


def printable(text: str, keep: str = "") -> str:
    r"""The text with every control character as an escape sequence such as ``\x1b``, ``\n`` or ``\u202e``.

    A terminal obeys control characters: a file name could clear the screen, imitate a message of semlive, or hide a part of itself.

    Args:
        text: any text.
        keep: characters that stay as they are, such as a line break in a text of several lines.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(one if one in keep or unicodedata.category(one) not in _HIDDEN else _escaped(one) for one in text)


def _escaped(one: str) -> str:
    code = ord(one)
    return _SHORT.get(one) or (f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}")
