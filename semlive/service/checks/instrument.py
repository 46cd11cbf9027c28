"""Checks of the instrument of a configuration: export folder, drivers, and the addresses of the devices."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Iterator, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from semlive import process_lock
from semlive.data.checks import Finding, Verdict
from semlive.data.frame import ExportedFile
from semlive.endpoints import tcp_names
from semlive.errors import SemliveError
from semlive.formats import check_finished
from semlive.formats.images.inspection import Inspection, inspect_file
from semlive.inputs.files import read_regular
from semlive.inputs.mask_file import read_mask
from semlive.ports import ChecksDevice, ChecksFiles
from semlive.process_lock import Holder
from semlive.service.config.configuration import Config
from semlive.service.config.sections import DriverSection
from semlive.service.runtime.clock import SystemClock
from semlive.service.watch.awaited_texts import missing_text
from semlive.service.watch.clock_offsets import probe_share
from semlive.service.watch.sidecars import sidecar_of
from semlive.service.watch.untaken_files import content_of, described
from semlive.service.watch.watch_settings import WatchSettings

GROUPS = ("load_frames", "stages", "triggers")
NETWORK_FILE_SYSTEMS = {"cifs", "smb3", "smbfs", "nfs", "nfs4", "9p", "fuse.sshfs", "afpfs", "davfs", "fuse.gvfsd-fuse"}
MODBUS_PORT = 502
PAGE_PORT = 8765
_CONNECT_TIMEOUT_S = 2.0
_MAX_EXAMPLE_BYTES = 2**28
SLOW_LISTING = 0.5
"""Largest part of `sem.poll_s` that listing the folder may take."""


def export_folder(config: Config) -> Iterator[Finding]:
    """Whether the export folder exists and is listed fast enough, its kind, and the clock of its computer."""
    folder, poll_s = config.sem.folder, config.sem.poll_s
    try:
        began = time.monotonic()
        with os.scandir(folder) as entries:
            for _ in entries:
                pass
        duration_s = time.monotonic() - began
    except OSError as error:
        advice = "mount the share of the SEM, create the folder, or correct sem.folder"
        yield Finding("export folder", f"{folder}: {error.strerror}", Verdict.FAILED, advice)
        return
    settings = WatchSettings(folder)
    content = content_of(settings)
    taken = f"{content.images} image{'' if content.images == 1 else 's'} that a run would take"
    observation = f"{folder}: {taken}, listed in {1e3 * duration_s:.0f} ms"
    slow = duration_s > SLOW_LISTING * poll_s
    advice = f"move old files away, or set sem.poll_s above {2 * duration_s:.1f}" if slow else ""
    yield Finding("export folder", observation, Verdict.UNKNOWN if slow else Verdict.OK, advice)
    for found, why in described(content, settings):
        yield Finding("not taken", found, Verdict.UNKNOWN, why)
    if content.newest:
        yield _newest_image(Path(content.newest), config)
    kind = file_system(folder)
    if kind in NETWORK_FILE_SYSTEMS:
        yield Finding("its arrivals", f"a network share ({kind}), which sends no events; checked every {poll_s:g} s", Verdict.OK)
    else:
        how = "checked at events and" if config.sem.file_events else "checked"
        yield Finding("its arrivals", f"a folder of this computer ({kind or 'unknown kind'}), {how} every {poll_s:g} s", Verdict.OK)
    yield _folder_clock(config)


def _newest_image(path: Path, config: Config) -> Finding:
    """Whether a run would take an image like the newest of the folder."""
    try:
        data, sidecar_path = read_regular(path, _MAX_EXAMPLE_BYTES), sidecar_of(path)
        sidecar = None if sidecar_path is None else read_regular(sidecar_path, _MAX_EXAMPLE_BYTES)
        mtime_ns = path.stat().st_mtime_ns
    except OSError as error:
        return Finding("newest image", f"{path.name}: cannot be read ({error.strerror})", Verdict.UNKNOWN, "check the permissions")
    file = ExportedFile(0, path.name, data, "", mtime_ns, mtime_ns, sidecar)
    inspection = inspect_file(file, config.sem.scan_profile, config.sem.vendor)
    problems = list(inspection.problems)
    if not problems and (unfinished := check_finished(file, config.sem.scan_profile, config.sem.vendor)) is not None:
        problems.append(unfinished)
    missing = missing_text(config.watch_settings(), sidecar)
    if not problems and missing is not None and missing.is_needed:
        problems.append(missing.reason)
    problems += _other_size(inspection, config)
    if problems:
        observation = f"{path.name}: a run would refuse an image like it: {' '.join(problems)}"
        return Finding("newest image", observation, Verdict.UNKNOWN, f"correct the export or sem, then: semlive inspect {path}")
    notes = f"; {' '.join(inspection.notes)}" if inspection.notes else ""
    return Finding("newest image", f"{path.name}: {inspection.vendor}, would be taken{notes}", Verdict.OK)


def _other_size(inspection: Inspection, config: Config) -> Iterator[str]:
    """Whether an image has another size than the mask, which a run refuses."""
    if config.dic.mask is not None and not inspection.problems:
        height, width = read_mask(config.dic.mask).shape
        if (inspection.width_px, inspection.height_px) != (width, height):
            frame = f"{inspection.width_px} x {inspection.height_px} px"
            yield f"its frame has {frame}, the mask (dic.mask) {width} x {height} px; draw the mask on such a frame."


def _folder_clock(config: Config) -> Finding:
    if not config.sem.probe_share:
        return Finding(
            "its clock", "not measured; nothing is written there", Verdict.UNKNOWN, "sem.probe_share: true measures it by a small file"
        )
    offset = probe_share(config.sem.folder, time.time_ns)
    if offset is None:
        return Finding("its clock", "the folder is not writable", Verdict.UNKNOWN, "allow writing, or set sem.probe_share: false")
    wrong = abs(offset.offset_s) > max(1.0, 3 * offset.sigma_s)
    advice = "set the clock of the computer of the folder" if wrong else ""
    return Finding(
        "its clock",
        f"{offset.offset_s:+.3f} ± {offset.sigma_s:.3f} s relative to this computer",
        Verdict.UNKNOWN if wrong else Verdict.OK,
        advice,
    )


def file_system(folder: Path, mounts: Path = Path("/proc/mounts")) -> str:
    """Kind of the file system of a folder; empty if the system does not report it."""
    try:
        lines = [line.split() for line in mounts.read_text(encoding="utf-8").splitlines()]
    except OSError:
        return ""
    path = str(folder.resolve())
    matches = [(len(mount), kind) for _, mount, kind, *_ in lines if path == mount or path.startswith(mount.rstrip("/") + "/")]
    return max(matches)[1] if matches else ""


def drivers(config: Config | None) -> Iterator[Finding]:
    """Whether every installed driver can be loaded, and every driver of the configuration is installed."""
    names: dict[str, list[str]] = {}
    for group in GROUPS:
        for point in entry_points(group=f"semlive.{group}"):
            try:
                point.load()
            except Exception as error:  # a package of another author can raise any exception at import
                observation = f"{point.name} ({point.value}): {type(error).__name__}: {error}"
                yield Finding("drivers", observation, Verdict.FAILED, "install its package again, or remove it")
            else:
                names.setdefault(group, []).append(point.name)
    observation = "; ".join(f"{group.replace('_', ' ')}: {', '.join(sorted(names.get(group, []))) or 'none'}" for group in GROUPS)
    good = bool(names.get("load_frames"))
    yield Finding(
        "drivers",
        observation,
        Verdict.OK if good else Verdict.FAILED,
        "" if good else "install semlive with its drivers (pip install semlive)",
    )
    for key, group, section in _sections(config):
        if section.driver not in names.get(group, []):
            yield Finding(
                key, f"driver {section.driver} is not installed", Verdict.FAILED, f"use one of {', '.join(sorted(names.get(group, [])))}"
            )


def check_device_endpoints(config: Config) -> Iterator[Finding]:
    """Whether a server listens or a serial port exists at every address of the drivers; nothing is sent to devices that move.

    A trigger that can report the settings of its microscope reads them.
    """
    for key, group, section in _sections(config):
        if group == "triggers" and (reported := tuple(check_trigger(config))):
            yield from reported
            continue
        endpoints = list(endpoints_in(section.settings))
        for endpoint in endpoints:
            yield _tcp(key, *endpoint) if isinstance(endpoint, tuple) else _serial(key, endpoint)
        files = list(check_device_files(group, section))
        yield from files
        if not endpoints and not files:
            yield Finding(key, f"driver {section.driver} has no address to check", Verdict.OK)


def check_trigger(config: Config) -> Iterator[Finding]:
    """What the microscope of the trigger reports, from drivers that can read it: settings of the scan, and whether it could scan now."""
    section = config.sem.trigger
    if section is None:
        return
    for point in entry_points(group="semlive.triggers", name=section.driver):
        try:
            module = import_module(point.module)
            if not isinstance(module, ChecksDevice):
                return
            folder = section.settings.get("folder")
            if isinstance(folder, str) and Path(folder).resolve() != config.sem.folder.resolve():
                observation = f"the trigger writes into {folder}, the run reads {config.sem.folder}"
                yield Finding("sem.trigger", observation, Verdict.FAILED, "give sem.trigger.settings.folder the path of sem.folder")
            yield from module.check_device(section.settings, SystemClock())
        except SemliveError as error:
            yield Finding("sem.trigger", str(error), Verdict.FAILED, "correct the settings of the driver")


def check_device_files(group: str, section: DriverSection) -> Iterator[Finding]:
    """Whether the files that a driver reads in a run can be read now: their head, units, and newest line."""
    for point in entry_points(group=f"semlive.{group}", name=section.driver):
        try:
            module = import_module(point.module)
            if isinstance(module, ChecksFiles):
                yield from module.check_files(section.settings, SystemClock())
        except SemliveError as error:
            yield Finding(group, str(error), Verdict.FAILED, "correct the settings of the driver")


def endpoints_in(settings: Mapping[str, Any]) -> Iterator[tuple[str, int, int] | str]:
    """TCP addresses (host, port, unit) and paths of serial ports in settings of any depth, each once."""
    reported: list[tuple[str, int, int] | str] = []
    endpoints: list[tuple[str, int, int] | str] = []
    if isinstance(host := settings.get("host"), str):
        endpoints.append((host, int(settings.get("port", MODBUS_PORT)), int(settings.get("unit", 1))))
    serial = settings.get("serial")
    if isinstance(serial, Mapping) and isinstance(port := serial.get("port"), str):
        endpoints.append(port)
    for key, value in settings.items():
        if isinstance(value, Mapping) and key != "serial":
            endpoints += endpoints_in(value)
    for endpoint in endpoints:
        if endpoint not in reported:
            reported.append(endpoint)
            yield endpoint


def page_port(port: int = PAGE_PORT) -> Finding:
    """Whether the usual port of the live page is free."""
    with socket.socket() as listener:
        try:
            listener.bind(("127.0.0.1", port))
        except OSError:
            return Finding(
                "live page", f"port {port} is in use", Verdict.UNKNOWN, "run chooses another port and prints it; or give --page-port"
            )
    return Finding("live page", f"port {port} is free", Verdict.OK)


def _tcp(key: str, host: str, port: int, unit: int) -> Finding:
    """Whether a port listens; a device of another run is not connected, because many devices drop an old connection for a new one."""
    with contextlib.ExitStack() as stack:
        for name in tcp_names(host, port, unit):
            try:
                lock = process_lock.acquire(name)
            except OSError as error:
                observation = f"no device can be reserved for a run ({error.strerror or error})"
                return Finding(key, observation, Verdict.FAILED, "allow semlive unix sockets (AF_UNIX), see docs/how-to/deploy.md")
            if isinstance(lock, Holder):
                observation = f"{host}:{port} unit {unit} is driven by another semlive already, {lock}"
                return Finding(key, observation, Verdict.FAILED, "stop that run first, or correct the endpoint")
            stack.callback(lock.release)
        return _listens(key, host, port)


def _listens(key: str, host: str, port: int) -> Finding:
    try:
        with socket.create_connection((host, port), _CONNECT_TIMEOUT_S):
            return Finding(key, f"{host}:{port} listens", Verdict.OK, "semlive frame check MAP shows which device replies")
    except OSError as error:
        observation = f"{host}:{port}: {error.strerror or 'no reply'}"
        return Finding(
            key,
            observation,
            Verdict.FAILED,
            "switch the device on, check cable, address and firewall; many devices accept one connection only",
        )


def _serial(key: str, port: str) -> Finding:
    if os.name == "nt":
        from serial.tools.list_ports import comports  # noqa: PLC0415

        ports = [candidate.device for candidate in comports()]
        good = port in ports
        return Finding(
            key,
            f"{port} {'exists' if good else 'does not exist'}",
            Verdict.OK if good else Verdict.FAILED,
            "" if good else f"the ports are {ports}",
        )
    if not os.path.exists(port):
        return Finding(
            key, f"{port}: no such port", Verdict.FAILED, "plug the adapter in; deploy/60-semlive.rules gives it a permanent name"
        )
    if not os.access(port, os.R_OK | os.W_OK):
        return Finding(
            key, f"{port}: this user has no permission", Verdict.FAILED, "join its group: sudo usermod -aG dialout $USER, then log in again"
        )
    return Finding(key, f"{port} exists", Verdict.OK, "semlive frame check MAP shows which device replies")


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
