"""What a configuration names: the export folder, the drivers, and the ends of their lines."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Iterator, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from semlive import process_lock
from semlive.data.checks import Finding, Verdict
from semlive.endpoints import tcp_names
from semlive.process_lock import Holder
from semlive.service.config.configuration import Config, DriverSection
from semlive.service.watch.clock_offsets import probe_share

GROUPS = ("load_frames", "stages", "triggers")
NETWORK_FILE_SYSTEMS = {"cifs", "smb3", "smbfs", "nfs", "nfs4", "9p", "fuse.sshfs", "afpfs", "davfs", "fuse.gvfsd-fuse"}
MODBUS_PORT = 502
PAGE_PORT = 8765
_CONNECT_S = 2.0
SLOW_LISTING = 0.5
"""Part of `sem.poll_s` that listing the folder may take."""


def export_folder(config: Config) -> Iterator[Finding]:
    """The folder into which the SEM exports: there, readable, listed fast enough; and the clock of whose it is."""
    folder, poll_s = config.sem.folder, config.sem.poll_s
    try:
        began = time.monotonic()
        with os.scandir(folder) as entries:
            count = sum(1 for _ in entries)
        took_s = time.monotonic() - began
    except OSError as error:
        advice = "mount the SEM's share, create the folder, or correct sem.folder"
        yield Finding("export folder", f"{folder}: {error.strerror}", Verdict.FAILED, advice)
        return
    said = f"{folder}: {count} files, listed in {1e3 * took_s:.0f} ms"
    slow = took_s > SLOW_LISTING * poll_s
    advice = f"move old files away, or set sem.poll_s above {2 * took_s:.1f}" if slow else ""
    yield Finding("export folder", said, Verdict.UNKNOWN if slow else Verdict.OK, advice)
    kind = file_system(folder)
    if kind in NETWORK_FILE_SYSTEMS:
        yield Finding("its arrivals", f"a share ({kind}): sends no events; it is looked at every {poll_s:g} s", Verdict.OK)
    else:
        yield Finding("its arrivals", f"a folder of this computer ({kind or 'unknown kind'}), looked at every {poll_s:g} s", Verdict.OK)
    yield _folder_clock(config)


def _folder_clock(config: Config) -> Finding:
    if not config.sem.probe_share:
        return Finding(
            "its clock", "not asked; nothing is written there", Verdict.UNKNOWN, "sem.probe_share: true lets it be asked by a small file"
        )
    told = probe_share(config.sem.folder, time.time_ns)
    if told is None:
        return Finding("its clock", "nothing may be written there", Verdict.UNKNOWN, "allow writing, or set sem.probe_share: false")
    wrong = abs(told.offset_s) > max(1.0, 3 * told.sigma_s)
    advice = "set the clock of the computer that keeps the folder" if wrong else ""
    return Finding(
        "its clock", f"{told.offset_s:+.3f} ± {told.sigma_s:.3f} s beside ours", Verdict.UNKNOWN if wrong else Verdict.OK, advice
    )


def file_system(folder: Path, mounts: Path = Path("/proc/mounts")) -> str:
    """Kind of the file system that holds a folder; empty where the system does not tell."""
    try:
        lines = [line.split() for line in mounts.read_text(encoding="utf-8").splitlines()]
    except OSError:
        return ""
    whole = str(folder.resolve())
    over = [(len(at), kind) for _, at, kind, *_ in lines if whole == at or whole.startswith(at.rstrip("/") + "/")]
    return max(over)[1] if over else ""


def drivers(config: Config | None) -> Iterator[Finding]:
    """Every installed driver can be loaded, and those that the configuration names are among them."""
    names: dict[str, list[str]] = {}
    for group in GROUPS:
        for point in entry_points(group=f"semlive.{group}"):
            try:
                point.load()
            except Exception as error:  # whatever a package of others does when it is imported
                said = f"{point.name} ({point.value}): {type(error).__name__}: {error}"
                yield Finding("drivers", said, Verdict.FAILED, "install its package again, or remove it")
            else:
                names.setdefault(group, []).append(point.name)
    said = "; ".join(f"{group.replace('_', ' ')}: {', '.join(sorted(names.get(group, []))) or 'none'}" for group in GROUPS)
    good = bool(names.get("load_frames"))
    yield Finding(
        "drivers", said, Verdict.OK if good else Verdict.FAILED, "" if good else "install semlive with its drivers (pip install semlive)"
    )
    for key, group, section in _sections(config):
        if section.driver not in names.get(group, []):
            yield Finding(
                key, f"driver {section.driver} is not installed", Verdict.FAILED, f"take one of {', '.join(sorted(names.get(group, [])))}"
            )


def check_device_endpoints(config: Config) -> Iterator[Finding]:
    """Whether something listens, or a serial port is there, at every end that drivers' settings name; nothing is said over it."""
    for key, _, section in _sections(config):
        ends = list(endpoints_in(section.settings))
        for end in ends:
            yield _tcp(key, *end) if isinstance(end, tuple) else _serial(key, end)
        if not ends:
            yield Finding(key, f"driver {section.driver} names no line to look at", Verdict.OK)


def endpoints_in(settings: Mapping[str, Any]) -> Iterator[tuple[str, int, int] | str]:
    """TCP addresses (host, port, unit) and paths of serial ports that settings hold, however deep; each once."""
    seen: list[tuple[str, int, int] | str] = []
    found: list[tuple[str, int, int] | str] = []
    if isinstance(host := settings.get("host"), str):
        found.append((host, int(settings.get("port", MODBUS_PORT)), int(settings.get("unit", 1))))
    serial = settings.get("serial")
    if isinstance(serial, Mapping) and isinstance(port := serial.get("port"), str):
        found.append(port)
    for key, value in settings.items():
        if isinstance(value, Mapping) and key != "serial":
            found += endpoints_in(value)
    for one in found:
        if one not in seen:
            seen.append(one)
            yield one


def page_port(port: int = PAGE_PORT) -> Finding:
    """Whether the live page gets its usual address."""
    with socket.socket() as one:
        try:
            one.bind(("127.0.0.1", port))
        except OSError:
            return Finding(
                "live page", f"port {port} is taken", Verdict.UNKNOWN, "another port is taken; run says which, or say --page-port"
            )
    return Finding("live page", f"port {port} is free", Verdict.OK)


def _tcp(key: str, host: str, port: int, unit: int) -> Finding:
    """Whether a port listens; a device that another run drives is left alone, as many drop one connection for the next."""
    with contextlib.ExitStack() as stack:
        for name in tcp_names(host, port, unit):
            try:
                lock = process_lock.acquire(name)
            except OSError as error:
                said = f"no device can be reserved for a run ({error.strerror or error})"
                return Finding(key, said, Verdict.FAILED, "allow semlive unix sockets (AF_UNIX), see docs/how-to/deploy.md")
            if isinstance(lock, Holder):
                said = f"{host}:{port} unit {unit} is driven by another semlive already, {lock}"
                return Finding(key, said, Verdict.FAILED, "stop that run first, or correct the endpoint")
            stack.callback(lock.release)
        return _listens(key, host, port)


def _listens(key: str, host: str, port: int) -> Finding:
    try:
        with socket.create_connection((host, port), _CONNECT_S):
            return Finding(key, f"{host}:{port} listens", Verdict.OK, "semlive frame check MAP asks who answers")
    except OSError as error:
        said = f"{host}:{port}: {error.strerror or 'no answer'}"
        return Finding(key, said, Verdict.FAILED, "switch it on, check cable, address and firewall; many devices serve one master only")


def _serial(key: str, port: str) -> Finding:
    if os.name == "nt":
        from serial.tools.list_ports import comports  # noqa: PLC0415

        there = [one.device for one in comports()]
        good = port in there
        return Finding(
            key,
            f"{port} {'is there' if good else 'is not there'}",
            Verdict.GOOD if good else Verdict.BAD,
            "" if good else f"there are {there}",
        )
    if not os.path.exists(port):
        return Finding(
            key, f"{port}: no such port", Verdict.FAILED, "plug the adapter in; deploy/60-semlive.rules gives it a name that stays"
        )
    if not os.access(port, os.R_OK | os.W_OK):
        return Finding(
            key, f"{port} may not be used by this user", Verdict.FAILED, "join its group: sudo usermod -aG dialout $USER, then log in anew"
        )
    return Finding(key, f"{port} is there", Verdict.OK, "semlive frame check MAP asks who answers")


def _sections(config: Config | None) -> Iterator[tuple[str, str, DriverSection]]:
    if config is None:
        return
    named = (
        ("load_frame", "load_frames", config.load_frame),
        ("stage", "stages", config.stage),
        ("trigger", "triggers", config.sem.trigger),
    )
    for key, group, section in named:
        if section is not None:
            yield key, group, section
