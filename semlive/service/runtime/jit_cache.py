"""Folder in which compiled kernels are stored between runs. It is set before numba is imported, and child processes inherit it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import MutableMapping
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"
KERNELS = Path(__file__).resolve().parents[2] / "kernels"


def configure_jit_cache(environ: MutableMapping[str, str], kernels: Path = KERNELS) -> Path:
    """Select the cache folder of the kernels and set the environment variable of numba.

    The folder is in the package if that is writable. Otherwise (a read-only installation, the sandbox of a service) it is the first
    writable one of: the cache folder of the service, that of the user, a new folder for temporary files.

    Args:
        environ: environment of this process; `NUMBA_CACHE_DIR` is set in it unless it is set already or not needed.
        kernels: folder of the package of kernels.

    Returns:
        The folder.
    """
    if environ.get(VARIABLE):
        return Path(environ[VARIABLE])
    in_package = kernels / "__pycache__"
    if may_write(in_package):
        return in_package
    chosen = next((folder for folder in _elsewhere(environ) if may_write(folder)), None)
    if chosen is None:
        chosen = Path(tempfile.mkdtemp(prefix="semlive-jit-"))
    environ[VARIABLE] = str(chosen)
    return chosen


def may_write(folder: Path) -> bool:
    """Return whether a file can be created in a folder, which is created if necessary; permissions do not show a read-only mount."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _elsewhere(environ: MutableMapping[str, str]) -> list[Path]:
    service = environ.get("CACHE_DIRECTORY", "").split(os.pathsep)[0]  # set by systemd from CacheDirectory=
    user = environ.get("XDG_CACHE_HOME") or environ.get("LOCALAPPDATA")
    home = environ.get("HOME") or environ.get("USERPROFILE")
    folders = [Path(service) / "jit"] if service else []
    folders += [Path(user) / "semlive" / "jit"] if user else []
    folders += [Path(home) / ".cache" / "semlive" / "jit"] if home else []
    return folders
