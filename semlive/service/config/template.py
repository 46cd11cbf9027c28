"""Text of a configuration with a comment on every key, from a few answers."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

FrameKind = Literal["modbus", "serial", "operator", "none"]
StageKind = Literal["operator", "modbus"]
Vendor = Literal["fei", "zeiss", "tescan", "jeol", "hitachi", "other"]

DATABAR_VENDORS = ("zeiss",)
"""Vendors whose databar is part of the image, without a header that gives its height."""
_PLAIN = re.compile(r"[A-Za-z/][\w./-]*|\d+(\.\d+){3}")
_CONSTANTS_OF_YAML = {"null", "true", "false", "yes", "no", "on", "off", "y", "n"}


@dataclass(frozen=True, slots=True)
class LabSetup:
    """Answers about laboratory and experiment from which a configuration is written.

    Attributes:
        name: name of the run.
        export_folder: folder into which the SEM saves.
        vendor: vendor of the SEM.
        pixel_size_um: edge of a pixel on the specimen, um.
        frame: connection of the load frame.
        address: host or serial port of the load frame, or the name of its program.
        device_map: device map of the load frame.
        stage: driver of the stage.
        specimen: name of the specimen.
        area_mm2: cross-section of the specimen, mm^2.
        loading_axis: image axis of the load.
        max_load_n: largest load of the plan, N.
        load_steps: number of loads, 2 or more.
        region_px: first and last subset centre (x0, y0, x1, y1).
        mask: name of the mask file in the folder of the configuration; None without masks.
    """

    name: str = "first-run"
    export_folder: str = "/mnt/sem/export"
    vendor: Vendor = "fei"
    pixel_size_um: float = 1.25
    frame: FrameKind = "modbus"
    address: str = "192.168.1.20"
    device_map: str = "generic"
    stage: StageKind = "operator"
    specimen: str = "AL2024-T4 sheet"
    area_mm2: float = 10.0
    loading_axis: Literal["x", "y"] = "y"
    max_load_n: float = 2000.0
    load_steps: int = 6
    region_px: tuple[int, int, int, int] = (101, 101, 846, 696)
    mask: str | None = None

    @property
    def loads_n(self) -> tuple[float, ...]:
        """Loads in equal steps from a tenth of the largest load, which removes slack; none without a load frame."""
        if self.frame == "none":
            return ()
        first, count = 0.1 * self.max_load_n, self.load_steps
        return tuple(round(first + (self.max_load_n - first) * k / (count - 1), 1) for k in range(count))


LAB_PRESETS: dict[str, LabSetup] = {
    "modbus-fei": LabSetup(name="al2024-01"),
    "serial-zeiss": LabSetup(
        name="steel-01",
        export_folder="/mnt/zeiss/autosave",
        vendor="zeiss",
        pixel_size_um=0.25,
        frame="serial",
        address="/dev/serial/by-id/usb-stand",
        device_map="mark10_esm",
        specimen="316L wire",
        area_mm2=0.5,
        max_load_n=150.0,
    ),
    "operator-deben": LabSetup(
        name="deben-01",
        export_folder="D:/sem/export",
        vendor="tescan",
        pixel_size_um=0.5,
        frame="operator",
        address="MICROTEST",
        specimen="copper strip",
        area_mm2=1.0,
        loading_axis="x",
        max_load_n=300.0,
    ),
}
"""Three kinds of laboratory, as in deploy/examples."""


def configuration_text(lab: LabSetup) -> str:
    """Text of a configuration with every key that `semlive run` needs and the most useful other ones, with units.

    Args:
        lab: answers about the laboratory.
    """
    sections = [_head(lab), _sem(lab), _load_frame(lab), _stage(lab), _specimen(lab), _protocol(lab), _limits(lab), _numerics(lab)]
    return "\n\n".join(section for section in sections if section) + "\n"


def _head(lab: LabSetup) -> str:
    return _lines(
        "# A run of semlive. Check it with: semlive doctor FILE, semlive plan FILE; then: semlive run FILE --attended",
        "# Keys that are left out have their defaults; an unknown key is rejected, with the most similar key.",
        "",
        "run:",
        (f"  name: {_quoted(lab.name)}", "name of the log, <folder>/<name>/<name>.000.mcap; each run needs a new one"),
        ("  folder: runs", "folder of the logs, relative to this file: a disk of this computer, not a network share"),
    )


def _sem(lab: LabSetup) -> str:
    vendor = (
        () if lab.vendor == "other" else ((f"  vendor: {lab.vendor}", "a file counts as complete only with the header of this vendor"),)
    )
    bar = ("    # databar_rows: 64", "px, rows of the databar below the image, if the image contains one")
    times: Sequence[str | tuple[str, str]] = ()
    if lab.vendor == "other":
        times = (
            ("    dwell_time_s: 1.0e-4", "s, time on one pixel; plain files do not contain it"),
            ("    row_time_s: 0.1071", "s, from the start of one row to the next, fly-back included"),
        )
    elif lab.vendor in ("tescan", "jeol", "hitachi"):
        times = (
            "    # these files do not contain all scan times: semlive inspect FILE shows which are missing",
            ("    dwell_time_s: 1.0e-5", "s, time on one pixel; used if the file has none"),
            ("    row_time_s: 1.1e-2", "s, from the start of one row to the next, fly-back included; used if the file has none"),
        )
    return _lines(
        "sem:",
        (f"  folder: {_quoted(lab.export_folder)}", "folder of the auto-save of the microscope; a network share is possible"),
        *vendor,
        (f"  pixel_size_um: {lab.pixel_size_um:g}", "um, edge of a pixel on the specimen; converts shifts in px into stage motion"),
        ("  poll_s: 1.0", "s, interval at which the folder is checked"),
        ("  stable_for_s: 2.0", "s, a file counts as complete after this time without change"),
        "  profile:",
        ("    start_anchor: end", "meaning of the time in the files: start or end of the scan, or save"),
        ("    start_sigma_s: 0.3", "s, standard uncertainty of the start time that follows from it"),
        ("    clock_offset_s: 0", "s, clock of the SEM minus UTC, time zone included; semlive reports the measured value"),
        *times,
        *((bar,) if lab.vendor in DATABAR_VENDORS else ()),
    )


def _load_frame(lab: LabSetup) -> str:
    if lab.frame == "none":
        return ""
    head: list[str | tuple[str, str]] = ["load_frame:"]
    if lab.frame == "modbus":
        host, port = host_and_port(lab.address)
        head += [
            ("  driver: modbus", "one device with Modbus, described by a register map"),
            ("  poll_s: 0.05", "s, between readings"),
            "  settings:",
            (f"    map: {_quoted(lab.device_map)}", "device map: semlive frame check MAP checks it without motion"),
            (f"    host: {_quoted(host)}", "address of the device"),
            (f"    port: {port or 502}", "TCP port"),
            ("    unit: 1", "Modbus unit (slave) number"),
            ("    watchdog_s: 2.0", "s, the device stops by itself after this time without communication"),
            ("    # confirmed: true", "set after the device map was compared with the machine"),
        ]
    elif lab.frame == "serial":
        head += [
            ("  driver: ascii", "one device with a text protocol on a serial line"),
            ("  poll_s: 0.2", "s, between readings"),
            "  settings:",
            (f"    map: {_quoted(lab.device_map)}", "device map: semlive frame check MAP checks it without motion"),
            (f"    serial: {{port: {_quoted(lab.address)}}}", "serial port; baud rate and parity are in the device map"),
            ("    approach:", "load approach of a test stand without load control, in short motions"),
            (
                f"      stiffness_n_mm: {lab.max_load_n:g}",
                "N/mm, of specimen, grips and stand in series: measure it; too high is safer than too low",
            ),
            ("      speed_max_mm_s: 0.05", "mm/s, maximum speed"),
            ("      speed_min_mm_s: 0.0084", "mm/s, minimum speed of the stand"),
            (f"      arrived_n: {load_tolerance_n(lab):g}", "N, distance from the target at which the motion ends"),
            ("    # confirmed: true", "set after the device map was compared with the machine"),
        ]
    else:
        head += [
            ("  driver: operator", "closed software: the operator moves the load frame on request"),
            ("  poll_s: 0.2", "s, between readings"),
            "  settings:",
            (f"    program: {_quoted(lab.address)}", "name of the program of the manufacturer"),
            (f"    arrived_n: {load_tolerance_n(lab):g}", "N, distance from the target at which the motion ends"),
            "    # load_file:                   # file into which the program records; without it the operator types the load",
            "    #   {file: 'C:/microtest/*.csv', force: {column: Force, unit: N}, extension: {column: 3, unit: mm}}",
        ]
    return _lines(*head)


def host_and_port(address: str) -> tuple[str, str]:
    """Host and TCP port of ``host``, ``host:port``, ``[IPv6]:port`` or an IPv6 address; the port is empty without one."""
    if address.startswith("["):
        host, _, port = address[1:].partition("]")
        return host, port.removeprefix(":")
    host, _, port = address.partition(":") if address.count(":") == 1 else (address, "", "")
    return host, port


def load_tolerance_n(lab: LabSetup) -> float:
    """Distance from the target load at which a motion ends, N; smaller than the load tolerance, so that noise does not exceed it."""
    fraction = {"modbus": 0.0025, "serial": 0.005}.get(lab.frame, 0.01)
    return max(fraction * lab.max_load_n, 0.1)


def _stage(lab: LabSetup) -> str:
    if lab.stage == "modbus":
        return _lines(
            "stage:",
            ("  driver: modbus", "stage of the specimen, or the beam shift with kind: beam"),
            ("  settings: {host: 192.168.1.20, port: 502, unit: 1, kind: specimen}", "address, and what is moved"),
        )
    return _lines(
        "stage:",
        ("  driver: operator", "the operator moves the specimen: semlive shows the distance, and waits for Enter"),
        (f"  settings: {{um_per_px: {lab.pixel_size_um:g}}}", "um per px, so that the prompt shows the distance in pixels, too"),
    )


def _specimen(lab: LabSetup) -> str:
    return _lines(
        "specimen:",
        (f"  name: {_quoted(lab.specimen)}", "free text"),
        (f"  area_mm2: {lab.area_mm2:g}", "mm^2, cross-section; add its uncertainty to that of E"),
        (f"  loading_axis: {lab.loading_axis}", "image axis of the load, x (columns) or y (rows)"),
    )


def _protocol(lab: LabSetup) -> str:
    unloaded: tuple[str | tuple[str, str], ...] = (
        "protocol:",
        ("  calibration_shifts_px:", "px, positions of the unloaded pairs (x, y) in both directions, to measure the distortion"),
        "    [[0, 0], [8, 0], [-16, 0], [0, 12], [24, 0], [0, -24], [-24, 0], [0, 24], [16, 8], [-8, -16], [0, 0]]",
        ("  translation_shifts_px: [[18, -11]]", "px, an unloaded test: the strain of these pairs must be zero"),
    )
    hold = (
        ("  hold_s: 30", "s, hold before each pair"),
        ("  settle_s: 5", "s, load and stage must stay within tolerance for this time before the hold"),
        ("  stage_tolerance_um: 5", "um, allowed distance of the stage reading from its target"),
        ("  frame_timeout_s: 900", "s, imaging without an acceptable frame for this time is a fault; at least three scans"),
    )
    if not lab.loads_n:
        return _lines(*unloaded, *hold)
    rate = max(round(lab.max_load_n / 100, 2), 0.1)
    return _lines(
        *unloaded,
        (f"  loads_n: [{', '.join(f'{load_n:g}' for load_n in lab.loads_n)}]", "N, loads at which pairs are taken, tension positive"),
        (f"  ramp_rate_n_s: {rate:g}", "N/s, between loads"),
        (f"  load_tolerance_n: {2.0 * load_tolerance_n(lab):g}", "N, allowed distance of the load from its target"),
        *hold,
        "  # warm_up:                      # delay the first load until the drift is slow",
        ("  #   max_rate_px_s: 0.005", "px/s, forecast drift rate plus its uncertainty"),
    )


def _limits(lab: LabSetup) -> str:
    if lab.frame == "none":
        return ""
    top, steps = lab.max_load_n, lab.loads_n
    largest = max(b - a for a, b in zip((0.0, *steps), steps, strict=False))
    return _lines(
        "limits:                           # checked at every command and every reading; limits of the device may be stricter",
        (f"  force_min_n: {-0.025 * top:g}", "N, lowest allowed force"),
        (f"  force_max_n: {1.1 * top:g}", "N, highest allowed force: below the strength of specimen and load frame"),
        ("  extension_min_mm: -0.5", "mm, lowest allowed crosshead extension"),
        ("  extension_max_mm: 2.0", "mm, highest allowed crosshead extension"),
        (f"  force_rate_max_n_s: {max(round(top / 40, 2), 0.3):g}", "N/s, fastest commanded ramp"),
        (f"  force_step_max_n: {1.2 * largest:g}", "N, largest commanded change of load in one step"),
        ("  stage_travel_um: 200", "um, largest allowed distance of the stage from its position at the start of the run"),
        (f"  force_drop_max_n: {max(0.1 * top, 1.0):g}", "N, a sudden decrease by more stops the run: slip or fracture"),
        (
            "  # stiffness_min_n_mm: 1000",
            "N/mm, half of the measured stiffness: without it, no rule finds a load cell that reads too little",
        ),
        (f"  # unloaded_max_n: {0.055 * top:g}", "N, largest preload of the unloaded pairs; by default 5 % of the larger force limit"),
    )


def _numerics(lab: LabSetup) -> str:
    return _lines(
        "dic:",
        ("  subset_px: 43", "px, edge of a subset, odd; three speckles across at least"),
        ("  step_px: 5", "px, distance of neighbouring points"),
        (f"  roi_px: [{', '.join(map(str, lab.region_px))}]", "px, first and last subset centre (x0, y0, x1, y1); null covers the frame"),
        *(() if lab.mask is None else ((f"  mask: {_quoted(lab.mask)}", "0 where frames must not be used; moves with the specimen"),)),
        "",
        "estimate:",
        ("  window_points: 9", "points, edge of the virtual strain gauge: (9 - 1) x 5 + 43 = 83 px"),
    )


def _lines(*lines: str | tuple[str, str]) -> str:
    """Return lines with aligned comments."""
    return "\n".join(line if isinstance(line, str) else f"{line[0]:<33} # {line[1]}" for line in lines)


def _quoted(text: str) -> str:
    """Return the text as YAML reads it again: without quotes only if it is neither a number nor a constant of YAML 1.1 or 1.2."""
    return text if _PLAIN.fullmatch(text) and text.casefold() not in _CONSTANTS_OF_YAML else json.dumps(text, ensure_ascii=False)
