"""Versions of the programs of a run, and the commit if semlive is in a repository."""

from __future__ import annotations

import json
import platform
import subprocess
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path

GIT_TIMEOUT_S = 5.0


def versions(packages: Iterable[str] = ()) -> dict[str, str]:
    """Return versions by name: semlive, its `commit` if it can be determined, Python, and the given packages."""
    own = {name: version(name) for name in ("semlive", *packages)}
    commit = commit_of("semlive", Path(__file__).resolve().parents[3])
    return {**own, **({"commit": commit} if commit else {}), "python": platform.python_version()}


def commit_of(package: str, folder: Path) -> str:
    """Return the hash of the commit of a package, with ``-dirty`` if its files were changed since; empty if it cannot be determined.

    Args:
        package: name of the package; the metadata of a package that was installed from a repository hold its commit (PEP 610).
        folder: folder of its source, if that is a repository.
    """
    try:
        origin = json.loads(distribution(package).read_text("direct_url.json") or "{}")
    except PackageNotFoundError:
        origin = {}
    installed_from = str(origin.get("vcs_info", {}).get("commit_id", ""))
    if installed_from or not (folder / ".git").exists():
        return installed_from
    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=GIT_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return result.stdout.strip() if result.returncode == 0 else ""
