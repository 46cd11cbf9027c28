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
    """By name: semlive, its `commit` where that can be told, Python, and the packages asked for."""
    own = {name: version(name) for name in ("semlive", *packages)}
    commit = commit_of("semlive", Path(__file__).resolve().parents[3])
    return {**own, **({"commit": commit} if commit else {}), "python": platform.python_version()}


def commit_of(package: str, folder: Path) -> str:
    """Hash of the commit that a package comes from, with ``-dirty`` if its files were changed since; empty if nobody knows.

    Args:
        package: name; one that was installed from a repository says so itself (PEP 610).
        folder: where its source stands, if that is a repository's.
    """
    try:
        origin = json.loads(distribution(package).read_text("direct_url.json") or "{}")
    except PackageNotFoundError:
        origin = {}
    installed_from = str(origin.get("vcs_info", {}).get("commit_id", ""))
    if installed_from or not (folder / ".git").exists():
        return installed_from
    asked = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        told = subprocess.run(asked, capture_output=True, text=True, timeout=GIT_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return told.stdout.strip() if told.returncode == 0 else ""
