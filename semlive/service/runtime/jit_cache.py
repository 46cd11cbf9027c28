"""Where compiled kernels are kept between runs. Known before anything is imported that compiles, and inherited by every child process."""

from __future__ import annotations

import os
import tempfile
from collections.abc import MutableMapping
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"
KERNELS = Path(__file__).resolve().parents[2] / "kernels"


def configure_jit_cache(environ: MutableMapping[str, str], kernels: Path = KERNELS) -> Path:
    """Decide where kernels are cached, and say so to whatever compiles them.

    Beside the package, where that may be written; otherwise (a read-only installation, a service's sandbox) the first folder that
    may be: the service's own cache folder, the user's, one in the folder for temporary files.

    Args:
        environ: of this process; `NUMBA_CACHE_DIR` is set in it unless it stands there already or is not needed.
        kernels: folder of the package whose functions are compiled.

    Returns:
        The folder.
    """
    if environ.get(VARIABLE):
        return Path(environ[VARIABLE])
    beside = kernels / "__pycache__"
    if may_write(beside):
        return beside
    chosen = next((folder for folder in _elsewhere(environ) if may_write(folder)), None)
    if chosen is None:
        chosen = Path(tempfile.mkdtemp(prefix="semlive-jit-"))
    environ[VARIABLE] = str(chosen)
    return chosen


def may_write(folder: Path) -> bool:
    """Whether a file can be made there, the folder too if need be; tried, because permissions alone do not tell of a read-only mount."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _elsewhere(environ: MutableMapping[str, str]) -> list[Path]:
    service = environ.get("CACHE_DIRECTORY", "").split(os.pathsep)[0]  # what systemd says of CacheDirectory=
    user = environ.get("XDG_CACHE_HOME") or environ.get("LOCALAPPDATA")
    home = environ.get("HOME") or environ.get("USERPROFILE")
    folders = [Path(service) / "jit"] if service else []
    folders += [Path(user) / "semlive" / "jit"] if user else []
    folders += [Path(home) / ".cache" / "semlive" / "jit"] if home else []
    return folders
