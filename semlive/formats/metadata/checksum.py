"""CRC-32 of MCAP and PNG (ISO 3309), with instructions of the processor where a build of ISA-L is available.

An image of 1 MB takes 0.03 ms with them and 0.36 ms with zlib; writing it to a fast disk takes 1.2 ms.
"""

from __future__ import annotations

try:
    from isal.isal_zlib import crc32
except ImportError:  # no build for this processor or system; zlib gives the same numbers, but is slower
    from zlib import crc32

__all__ = ["crc32"]
