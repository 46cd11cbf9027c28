"""One pair correlated in the unit's sandbox: nothing may be written but log and cache, there is no home, and kernels are compiled.

    sudo python tests/benchmarks/bench_sandbox.py

Where systemd runs, the properties are those of deploy/semlive@.service (systemd-run). Elsewhere a mount namespace replaces it: the
complete system read-only, an empty home, and a cache folder given by CACHE_DIRECTORY, as by systemd; the unit's limits on system
calls, devices and networks are then not tested. The second run shows that what was compiled is kept.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
UNIT = ROOT / "deploy" / "semlive@.service"
EXCLUDED_PROPERTIES = (
    "Type",
    "Exec",
    "Notify",
    "Watchdog",
    "Kill",
    "Timeout",
    "Restart",
    "User",
    "Group",
    "Supplementary",
    "Working",
    "State",
    "Cache",
    "Env",
)
READ_ONLY = """
mount --make-rprivate / && mount -t tmpfs none "$HOME" && mount --bind "$WRITABLE" "$WRITABLE" &&
mount -o remount,bind,ro / && mount -o remount,bind,rw "$WRITABLE" && cd "$WRITABLE" && exec "$@"
"""


def pair(folder: Path) -> list[str]:
    """Two pictures of speckle, one shifted by 3 px along x."""
    speckle = cv2.GaussianBlur(np.random.default_rng(1).standard_normal((320, 320)), (0, 0), 2.5)
    image = np.clip(128 + 300 * speckle, 0, 255).astype(np.uint8)
    paths = [folder / "ref.png", folder / "cur.png"]
    for path, item in zip(paths, (image, np.roll(image, 3, axis=1)), strict=True):
        cv2.imwrite(str(path), item)
    return [str(path) for path in paths]


def command(folder: Path, work: list[str]) -> tuple[list[str], dict[str, str]]:
    """How the sandbox is entered, and the environment in it."""
    environ = {"PATH": os.environ["PATH"], "PYTHONDONTWRITEBYTECODE": "1"}
    if Path("/proc/1/comm").read_text(encoding="utf-8").strip() == "systemd":
        lines = re.findall(r"^(\w+)=(.*)$", UNIT.read_text(encoding="utf-8").partition("[Service]")[2], re.MULTILINE)
        stored = [f"--property={key}={value}" for key, value in lines if not key.startswith(EXCLUDED_PROPERTIES)]
        own = [f"--property=ReadWritePaths={folder}", f"--setenv=NUMBA_CACHE_DIR={folder}/jit"]
        return ["systemd-run", "--wait", "--pipe", "--quiet", *stored, *own, *work], environ
    home = Path.home()
    inside = [item for item in (Path(sys.executable), ROOT) if item.resolve().is_relative_to(home)]
    hidden = str(folder / "home") if inside else str(home)  # a Python that lives in the home folder must stay to be seen
    Path(hidden).mkdir(exist_ok=True)
    environ |= {"HOME": hidden, "CACHE_DIRECTORY": str(folder), "WRITABLE": str(folder)}
    return ["unshare", "--mount", "sh", "-c", READ_ONLY, "sh", *work], environ


def main() -> int:
    """Correlate twice, and report the times."""
    with tempfile.TemporaryDirectory(prefix="semlive-sandbox-") as name:
        folder = Path(name)
        work = [sys.executable, "-m", "semlive", "dic", *pair(folder), "--step", "20", "--json"]
        entered, environ = command(folder, work)
        for which in ("first", "second"):
            began = time.monotonic()
            done = subprocess.run(entered, env=environ, capture_output=True, text=True, timeout=600, check=False)
            stored = sum(1 for _ in folder.rglob("*.nbi"))
            sys.stdout.write(f"{which}: exit code {done.returncode}, {time.monotonic() - began:.1f} s, {stored} compiled functions kept\n")
            if done.returncode != 0 or not stored:
                sys.stderr.write(done.stderr[-2000:])
                return 1
        sys.stdout.write(done.stdout[:300] + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
