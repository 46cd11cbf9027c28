"""Whether another program still has a file open for writing, where the system tells.

Windows does: a reader that asks for no writers beside it is refused (sharing violation) as long as somebody has the file open for
writing, also on a share whose server is Windows or Samba. Other systems do not keep programs from one another; there nothing is told, and
only the file's bytes and their standing still speak for it.
"""

from __future__ import annotations

import errno
import sys
from pathlib import Path

_SHARING_VIOLATION, _LOCK_VIOLATION = 32, 33
_BUSY = frozenset({errno.EBUSY, errno.ETXTBSY})


def is_locked_error(error: OSError) -> bool:
    """Whether reading failed because another program has the file for itself, here or (EBUSY, ETXTBSY) on the share's server."""
    return getattr(error, "winerror", None) in (_SHARING_VIOLATION, _LOCK_VIOLATION) or error.errno in _BUSY


if sys.platform == "win32":
    import ctypes
    from ctypes import wintypes

    _GENERIC_READ, _SHARE_READ, _OPEN_EXISTING, _NORMAL = 0x8000_0000, 1, 3, 0x80
    _INVALID = ctypes.c_void_p(-1).value
    _kernel = ctypes.WinDLL("kernel32", use_last_error=True)
    _kernel.CreateFileW.restype = wintypes.HANDLE
    _kernel.CreateFileW.argtypes = [
        *(wintypes.LPCWSTR, wintypes.DWORD, wintypes.DWORD, wintypes.LPVOID, wintypes.DWORD, wintypes.DWORD, wintypes.HANDLE)
    ]
    _kernel.CloseHandle.argtypes = [wintypes.HANDLE]

    def open_elsewhere(path: Path) -> bool:
        """Whether another program has the file open for writing; readers do not count, and any other failure is left to the reader."""
        handle = _kernel.CreateFileW(str(path), _GENERIC_READ, _SHARE_READ, None, _OPEN_EXISTING, _NORMAL, None)
        if handle == _INVALID:
            return ctypes.get_last_error() in (_SHARING_VIOLATION, _LOCK_VIOLATION)
        _kernel.CloseHandle(handle)
        return False

else:

    def open_elsewhere(path: Path) -> bool:
        """Nothing is told here."""
        del path
        return False
