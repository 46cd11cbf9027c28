"""Building the independent load frame from its C source."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
PEERS = ROOT.parent / "shared" / "peers"
"""Folder of the source of the independent frame, next to the repository by default."""
_INSTALL = "on Debian: apt install gcc libmodbus-dev"
_HEADERS = Path("/usr/include/modbus")


class CannotBuild(Exception):
    """The independent frame cannot be built; the message states why."""


def missing_tool(peers: Path) -> str | None:
    """Why the independent frame cannot be built here, as a message; None if it can."""
    if not (peers / "frame.c").is_file():
        return f"{peers / 'frame.c'} does not exist; give the folder of the independent load frame with --peers"
    if shutil.which("gcc") is None:
        return f"gcc is not installed, so frame.c cannot be built; {_INSTALL}"
    if _flags() is None:
        return f"libmodbus is not installed, so frame.c cannot be built; {_INSTALL}"
    return None


def _flags() -> list[str] | None:
    """Compiler options for libmodbus; None if it is not installed."""
    if shutil.which("pkg-config") is not None:
        found = subprocess.run(["pkg-config", "--cflags", "--libs", "libmodbus"], capture_output=True, text=True, check=False)
        if found.returncode == 0:
            return shlex.split(found.stdout)
    return [f"-I{_HEADERS}", "-lmodbus"] if (_HEADERS / "modbus.h").is_file() else None


def build(peers: Path, folder: Path) -> Path:
    """Compile frame.c into a folder.

    Returns:
        The executable.

    Raises:
        CannotBuild: the source, gcc or libmodbus is missing, or the compiler failed.
    """
    if why := missing_tool(peers):
        raise CannotBuild(why)
    executable = folder / "frame"
    command = ["gcc", "-O2", "-o", str(executable), str(peers / "frame.c"), *(_flags() or []), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise CannotBuild(f"gcc cannot compile {peers / 'frame.c'}: {' '.join(done.stderr.split())[-200:]}")
    return executable
