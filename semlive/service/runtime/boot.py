"""Identity of the boot to which the monotonic clock belongs."""

from __future__ import annotations

import os
from pathlib import Path


def boot_id() -> str:
    """Identity of this boot; empty where the system tells none."""
    path = Path("/proc/sys/kernel/random/boot_id")
    return path.read_text(encoding="ascii").strip() if os.name == "posix" and path.exists() else ""
