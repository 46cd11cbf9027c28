"""Detection of files that another program has open for writing, where the system supports it.

On Windows, opening a file without write sharing fails (sharing violation) while another program has it open for writing, also on a share of
a Windows or Samba server. Other systems have no mandatory locks; there, a file is assessed only by its content and constancy.
"""

from __future__ import annotations

import errno
import sys
from pathlib import Path

_SHARING_VIOLATION, _LOCK_VIOLATION = 32, 33
_BUSY = frozenset({errno.EBUSY, errno.ETXTBSY})


def is_locked_error(error: OSError) -> bool:
    """Whether reading failed because another program locks the file, here or (EBUSY, ETXTBSY) on the server of the share."""
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
        """Whether another program has the file open for writing; readers do not count, and other errors are left to the reader."""
        handle = _kernel.CreateFileW(str(path), _GENERIC_READ, _SHARE_READ, None, _OPEN_EXISTING, _NORMAL, None)
        if handle == _INVALID:
            return ctypes.get_last_error() in (_SHARING_VIOLATION, _LOCK_VIOLATION)
        _kernel.CloseHandle(handle)
        return False

else:

    def open_elsewhere(path: Path) -> bool:
        """Return False: this system does not report it."""
        del path
        return False
