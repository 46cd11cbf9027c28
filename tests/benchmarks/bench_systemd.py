"""The unit under a live systemd: a Debian of its own is booted in a container, and runs an experiment on the simulated bench.

    sudo python tests/benchmarks/bench_systemd.py [--root FOLDER] [--keep]

Needs root, systemd-nspawn, mmdebstrap and about four minutes; nothing outside the folder is touched. It follows
docs/how-to/deploy.md; its commands are taken from the page:
- a service starts, counts as started when devices answer, and reports it to `systemctl status`; the sandbox is that of the unit;
- `systemctl stop` stops the frame, finishes the log and ends in order;
- a daemon whose loop hangs (it is sent SIGSTOP) is killed by the watchdog, the load frame stops by its own, and the run is resumed.

Exits with 1 where one of these does not hold.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml
from pymodbus.client import ModbusTcpClient

from semlive.cli.shared.simulated_run import daemon_config

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = "systemd,systemd-sysv,dbus,python3,python3-venv,libgomp1"
RUN = "al2024-01"
RATE = 20.0
WATCHDOG_S = 6
"""In place of the unit's 60 s, so that nobody waits a minute for it."""
SCENARIO = {
    "extends": "paper_x200",
    "scan": {"width_px": 320, "height_px": 276, "frame_time_s": 9.4},
    "export": {"databar_rows": 30},
    "experiment": {
        "protocol": {"calibration_shifts_px": [[0, 0], [12, 0], [0, 12]], "translation_shifts_px": [], "loads_n": [200, 500, 800]},
        "dic": {"subset_px": 31, "step_px": 8, "roi_px": None},
        "estimate": {"accept_poor_calibration": True},
    },
}


class Machine:
    """A booted Debian.

    Args:
        root: its files.
        leader: its first process, as seen from here.
    """

    def __init__(self, root: Path, leader: int) -> None:
        self.root, self._leader = root, leader

    def run(self, *words: str, check: bool = True) -> str:
        """A command in it; gives what it printed."""
        entered = ["nsenter", "--target", str(self._leader), "--all", "--", "env", "PATH=/usr/sbin:/usr/bin:/sbin:/bin", *words]
        done = subprocess.run(entered, capture_output=True, text=True, timeout=900, check=False)
        if check and done.returncode != 0:
            raise SystemExit(f"{shlex.join(words)}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
        return done.stdout.strip()

    def unit(self, name: str) -> dict[str, str]:
        """Properties of a unit reported by systemd."""
        required = "ActiveState,SubState,Result,StatusText,MainPID,WatchdogUSec,ExecMainStatus,ExecMainCode"
        return dict(line.split("=", 1) for line in self.run("systemctl", "show", "-p", required, name).splitlines())

    def until(self, true: Callable[[], object], what: str, timeout_s: float = 120.0) -> None:
        """Wait for something that must come."""
        end_s = time.monotonic() + timeout_s
        while not true():
            if time.monotonic() > end_s:
                raise SystemExit(
                    f"{what}: it did not come to that in {timeout_s:.0f} s\n{self.run('journalctl', '--no-pager', '-n', '40')}"
                )
            time.sleep(0.5)


def made(root: Path) -> None:
    """A Debian with semlive from its wheel, set up for systemd by docs/how-to/deploy.md."""
    if not (root / "bin").exists():
        subprocess.run(["mmdebstrap", "--quiet", "--variant=minbase", f"--include={PACKAGES}", "bookworm", str(root)], check=True)
    if (root / "opt" / "semlive").exists():
        return
    wheels = root / "wheels"
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(wheels)], cwd=ROOT, check=True, capture_output=True
    )
    (wheel,) = wheels.glob("semlive-*.whl")
    inside = ["chroot", str(root), "python3", "--version"]
    version = subprocess.run(inside, capture_output=True, text=True, check=True).stdout.split()[1]
    fetch = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--only-binary=:all:"]
    subprocess.run([*fetch, f"--python-version={version}", "-d", str(wheels), str(wheel)], check=True)
    install = "python3 -m venv /opt/semlive && /opt/semlive/bin/pip install --quiet --no-index --find-links /wheels semlive"
    subprocess.run(["chroot", str(root), "env", "-i", "PATH=/usr/bin:/bin", "sh", "-c", install], check=True)


@contextmanager
def booted(root: Path) -> Iterator[Machine]:
    """The Debian, running."""
    command = ["systemd-nspawn", "--quiet", "--directory", str(root), "--register=no", "--keep-unit", "--boot", "--console=read-only"]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as container:
        children = Path(f"/proc/{container.pid}/task/{container.pid}/children")
        while not (found := children.read_text(encoding="ascii").split()):
            time.sleep(0.2)
        machine = Machine(root, int(found[0]))
        time.sleep(2.0)
        machine.until(lambda: machine.run("systemctl", "is-system-running", check=False) in ("running", "degraded"), "booting")
        try:
            yield machine
        finally:
            machine.run("systemctl", "poweroff", check=False)
            container.wait(60)


def lines(first: str) -> list[str]:
    """The page's lines of the block that begins so, without sudo."""
    page = (ROOT / "docs" / "how-to" / "deploy.md").read_text(encoding="utf-8")
    block = re.search(rf"^ {{4}}{re.escape(first)}.*\n(?: {{4}}.*\n)*", page, re.MULTILINE)
    assert block is not None, first
    return [line.strip().replace("sudo ", "") for line in block[0].splitlines()]


def deployed(machine: Machine, config: dict[str, Any], name: str) -> None:
    """The page's own lines: user, unit and configuration, but for those that start it and follow its journal."""
    user = machine.run("id", "semlive", check=False)
    folder = machine.root / "srv" / "lab" / "deploy"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "semlive@.service").write_bytes((ROOT / "deploy" / "semlive@.service").read_bytes())
    (folder.parent / "my-run.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")
    for line in lines("sudo useradd"):
        if not line.startswith(("systemctl start", "journalctl")) and not (line.startswith("useradd") and user):
            machine.run("sh", "-c", f"cd /srv/lab && {line.replace(RUN, name)}")


def main() -> int:
    """Boot, deploy, run, stop, hang; report the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--root", type=Path, help="folder of the Debian, made if it is not there; without it one that goes at the end")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="semlive-systemd-") as name:
        root = arguments.root or Path(name) / "root"
        root.mkdir(parents=True, exist_ok=True)
        made(root)
        bench = root / "srv" / "bench"
        for item in (bench, root / "var" / "lib" / "semlive"):
            shutil.rmtree(item, ignore_errors=True)
        bench.mkdir(parents=True)
        (bench / "scenario.yaml").write_text(yaml.safe_dump(SCENARIO), encoding="utf-8")
        with booted(root) as machine:
            trial = Trial(machine, bench)
            trial.stopped()
            trial.hung()
            return 1 if trial.failed else 0


class Trial:
    """The experiments with the unit, and how many of them failed.

    Args:
        machine: booted.
        folder: for the bench.
    """

    def __init__(self, machine: Machine, folder: Path) -> None:
        self._machine, self.failed = machine, 0
        simulator = ["-m", "semlive_simulators.bench", "--scenario", "/srv/bench/scenario.yaml", "--out", "/srv/bench", "--rate", str(RATE)]
        machine.run("systemd-run", "--unit=bench", "/opt/semlive/bin/python", *simulator, "--mode", "continuous")
        machine.until((folder / "ready.json").exists, "the bench")
        self._bench = json.loads((folder / "ready.json").read_text(encoding="utf-8"))

    def stopped(self) -> None:
        """Started, and stopped in order."""
        machine, unit = self._machine, f"semlive@{RUN}.service"
        deployed(machine, self._config(RUN), RUN)
        began_s = time.monotonic()
        machine.run("systemctl", "start", unit)
        reported = machine.unit(unit)
        ready = reported["ActiveState"] == "active"
        self._report(f"started and ready in {time.monotonic() - began_s:.0f} s: {reported['ActiveState']}, {reported['StatusText']}", ready)
        exposure = machine.run("systemd-analyze", "security", "--no-pager", unit, check=False).splitlines()[-1]
        self._report(exposure.strip(" →"), float(exposure.split(": ")[1].split()[0]) <= 2.5)
        machine.until(lambda: "2 pairs analysed" in self._journal(unit), "two pairs")
        self._report("the live page's address is in the journal", "live page: http://127.0.0.1:8765/#token=" in self._journal(unit))
        stored = sum(1 for _ in (machine.root / "var" / "cache" / "semlive").rglob("*.nbi"))
        self._report(f"{stored} compiled functions are kept in /var/cache/semlive", stored > 0)
        began_s = time.monotonic()
        machine.run("systemctl", "stop", unit)
        took_s, log = time.monotonic() - began_s, list((machine.root / "var" / "lib" / "semlive" / "runs" / RUN).glob("*.mcap"))
        self._report(f"stopped in {took_s:.0f} s, its log is finished", len(log) == 1)
        self._report("the unit reports that it did not complete", machine.unit(unit)["ExecMainStatus"] == "1")

    def hung(self) -> None:
        """A loop that hangs: the report of the watchdog, that of the load frame, and the resumed run."""
        machine, name = self._machine, "hung-01"
        unit = f"semlive@{name}.service"
        deployed(machine, self._config(name), name)
        drop_in = machine.root / "etc" / "systemd" / "system" / "semlive@.service.d"
        drop_in.mkdir(exist_ok=True)
        (drop_in / "quick.conf").write_text(f"[Service]\nWatchdogSec={WATCHDOG_S}\n", encoding="utf-8")
        machine.run("systemctl", "daemon-reload")
        machine.run("systemctl", "start", unit)
        machine.until(lambda: "2 pairs analysed" in self._journal(unit), "two pairs")
        time.sleep(2.5 * WATCHDOG_S)
        alive = machine.unit(unit)["ActiveState"] == "active"
        self._report(f"it lives, with a watchdog of {WATCHDOG_S} s", alive)
        began_s = time.monotonic()
        machine.run("systemctl", "kill", "--kill-whom=main", "--signal=STOP", unit)
        machine.until(lambda: machine.unit(unit)["ActiveState"] not in ("active", "deactivating"), "the watchdog")
        took_s, result = time.monotonic() - began_s, machine.unit(unit)["Result"]
        self._report(f"a daemon that hangs was ended after {took_s:.0f} s: {result}", result == "watchdog")
        with ModbusTcpClient(self._bench["host"], port=self._bench["port"], timeout=2) as line:
            status, why = (line.read_input_registers(at, count=1, device_id=self._bench["unit"]).registers[0] for at in (3, 300))
        self._report(f"the load frame reports {status} (2: fault), because of {why} (2: its watchdog)", (status, why) == (2, 2))
        for line in lines("echo OPTIONS=--resume"):
            machine.run("sh", "-c", line.replace(RUN, name))
        asks = machine.unit(unit)["ActiveState"] == "active"
        machine.until(lambda: "recover" in self._journal(unit), "the question")
        self._report("resumed: it asks before it continues", asks)
        machine.run("systemctl", "stop", unit)

    def _config(self, name: str) -> dict[str, Any]:
        own = daemon_config(self._bench, RATE)
        own["run"] |= {"name": name, "folder": "/var/lib/semlive/runs"}
        own["protocol"]["load_tolerance_n"] = 20.0
        return json.loads(json.dumps(own))

    def _journal(self, unit: str) -> str:
        return self._machine.run("journalctl", "--no-pager", "-u", unit)

    def _report(self, what: str, holds: bool) -> None:
        self.failed += not holds
        sys.stdout.write(f"{'ok ' if holds else 'BAD'} {what}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
