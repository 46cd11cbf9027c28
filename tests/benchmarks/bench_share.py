"""Files that arrive on a real share: a Samba server, the share mounted over SMB, the watch on the mounted side.

    python tests/benchmarks/bench_share.py [--files 300] [--seed 1] [--seconds-away 8]

Needs root and the packages samba and smbnetfs. The server answers at 127.0.0.45 alone. Files are written on the server's own disk, as a
microscope's computer does, in the patterns of bench_watch.py, a step a second by the real clock; the watch uses the mounted folder, as
the control computer does. When all are there, and many still wait to be judged, the server is killed and comes back. Left out is what
changes with its size and modification time put back: Samba reports the modification time as the time of change. One JSON line is printed;
the code is 1 if any verdict is wrong, missing or given twice.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from arrivals.patterns import SCENES, overwritten_unseen
from arrivals.scene import GIVE_UP_S, SIDECAR_S, HandClock, Scene, Steps, wrong_verdicts

ADDRESS = "127.0.0.45"
_SERVER = """
[global]
interfaces = {address}/8
bind interfaces only = yes
smb ports = 445
server role = standalone server
map to guest = Bad User
guest account = root
disable netbios = yes
load printers = no
disable spoolss = yes
private dir = {folder}
lock directory = {folder}
state directory = {folder}
cache directory = {folder}
pid directory = {folder}
ncalrpc dir = {folder}/rpc
log file = {folder}/log
[export]
path = {share}
guest ok = yes
read only = no
"""


class WallClock(HandClock):
    """Real time."""

    def now(self) -> None:
        """Read it."""
        self.ns = time.time_ns()


class Server:
    """Samba, with one share that anybody may write."""

    def __init__(self, folder: Path, share: Path) -> None:
        self._settings = folder / "smb.conf"
        self._settings.write_text(_SERVER.format(address=ADDRESS, folder=folder, share=share), encoding="utf-8")
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Serve."""
        command = ["smbd", "--foreground", "--no-process-group", f"--configfile={self._settings}"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)

    def kill(self) -> None:
        """It and the processes of its connections are gone, as when the computer lost its power."""
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()


@contextlib.contextmanager
def mounted(folder: Path) -> Iterator[Path]:
    """The share mounted on another computer."""
    home, place = folder / "home", folder / "mounted"
    place.mkdir()
    (home / ".smb").mkdir(parents=True)
    for name, text in (("smb.conf", ""), ("smbnetfs.conf", ""), ("smbnetfs.auth", ""), ("smbnetfs.host", "")):
        (home / ".smb" / name).write_text(text, encoding="utf-8")
        (home / ".smb" / name).chmod(0o600)
    process = subprocess.Popen(["smbnetfs", str(place), "-f"], env={**os.environ, "HOME": str(home)}, stderr=subprocess.DEVNULL)
    try:
        share, until_s = place / ADDRESS / "export", time.monotonic() + 20.0
        while True:
            with contextlib.suppress(OSError):
                if list(share.iterdir()):
                    break
            if time.monotonic() > until_s or process.poll() is not None:
                raise RuntimeError("the share cannot be mounted: is this root, and are samba and smbnetfs installed?")
            time.sleep(0.5)
        yield share
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


def play(scenes: list[Scene], files: int, server: Server, away_s: float) -> None:
    """A step a second, by the real clock, until nothing more can come of any file."""
    running: list[Steps] = []
    began_s = time.monotonic()
    end_s, away, back_s = began_s + 1.0, False, 0.0
    while time.monotonic() < end_s or running:
        step_s = time.monotonic()
        for (_, _, patterns), scene in zip(SCENES, scenes, strict=True):
            scene.clock.now()  # type: ignore[attr-defined]
            if len(scene.expected) < files // len(scenes):
                end_s = step_s + SIDECAR_S + 2 * GIVE_UP_S + away_s
                expected = [one for one in patterns if one is not overwritten_unseen]
                running += [expected[int(scene.rng.integers(len(expected)))](scene) for _ in range(3)]
        running = [one for one in running if next(one, running) is None]
        if not away and not running:
            away, back_s = True, step_s + away_s
            server.kill()
        if away and 0.0 < back_s < step_s:
            back_s = 0.0
            server.start()
        for scene in scenes:
            scene.clock.now()  # type: ignore[attr-defined]
            scene.folder.poll()
        time.sleep(max(0.0, step_s + 1.0 - time.monotonic()))


def measure(files: int, seed: int, away_s: float, folder: Path) -> dict[str, object]:
    """The complete campaign."""
    share = folder / "share"
    (folder / "server" / "rpc").mkdir(parents=True)
    for number in range(len(SCENES)):
        (share / f"export{number}").mkdir(parents=True)
    server = Server(folder / "server", share)
    server.start()
    try:
        with mounted(folder) as mount:
            scenes = []
            for number, (vendor, vendors, _) in enumerate(SCENES):
                chance, path = np.random.default_rng((seed, number)), share / f"export{number}"
                scene = Scene(path, folder / f"away{number}", WallClock(), vendors, chance, vendor, mount / path.name)
                scene.clock.now()  # type: ignore[attr-defined]
                scene.open()
                scenes.append(scene)
            play(scenes, files, server, away_s)
    finally:
        server.kill()
    wrong = [one for scene in scenes for one in wrong_verdicts(scene)]
    counts = Counter(one.pattern for scene in scenes for one in scene.expected.values())
    return {
        "files": counts.total(),
        "seed": seed,
        "taken": sum(len(scene.files) for scene in scenes),
        "refused": sum(len(scene.refused) for scene in scenes),
        "troubles": sorted({one for scene in scenes for one in scene.troubles}),
        "wrong": len(wrong),
        "first_wrong": wrong[:20],
        "by_pattern": dict(sorted(counts.items())),
    }


def main() -> int:
    """Run the campaign that the arguments ask for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds-away", type=float, default=8.0)
    arguments = parser.parse_args()
    if shutil.which("smbd") is None or shutil.which("smbnetfs") is None:
        parser.error("smbd and smbnetfs are not installed; install the packages samba and smbnetfs")
    with tempfile.TemporaryDirectory() as folder:
        figures = measure(arguments.files, arguments.seed, arguments.seconds_away, Path(folder))
    sys.stdout.write(json.dumps(figures) + "\n")
    return 1 if figures["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
