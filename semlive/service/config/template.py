"""A configuration as text with a comment on every key, from a few answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

FrameKind = Literal["modbus", "serial", "operator", "none"]
StageKind = Literal["operator", "modbus"]
Vendor = Literal["fei", "zeiss", "tescan", "jeol", "hitachi", "other"]

DATABAR_VENDORS = ("zeiss",)
"""Their databars are burnt into the image and not told of in the file."""


@dataclass(frozen=True, slots=True)
class LabSetup:
    """What has to be known of a laboratory and an experiment to begin with.

    Attributes:
        name: of the run.
        export_folder: where the SEM saves.
        vendor: of the SEM.
        pixel_size_um: edge of a pixel on the specimen, um.
        frame: how the load frame is reached.
        address: its host, its serial port, or what the operator calls its program.
        device_map: its description.
        stage: what moves the specimen.
        specimen: its name.
        area_mm2: its cross-section, mm^2.
        loading_axis: image axis that is pulled.
        max_load_n: the largest load of the plan, N.
        load_steps: number of loads.
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

    @property
    def loads_n(self) -> tuple[float, ...]:
        """From a tenth of the largest load, which takes up slack, in equal steps; none without a load frame."""
        if self.frame == "none":
            return ()
        first, count = 0.1 * self.max_load_n, max(self.load_steps, 2)
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
"""Three kinds of lab, as deploy/examples shows them."""


def configuration_text(lab: LabSetup) -> str:
    """A whole configuration; every key that `semlive run` needs, and the most useful others, with its unit.

    Args:
        lab: the answers.
    """
    sections = [_head(lab), _sem(lab), _load_frame(lab), _stage(lab), _specimen(lab), _protocol(lab), _limits(lab), _numerics()]
    return "\n\n".join(section for section in sections if section) + "\n"


def _head(lab: LabSetup) -> str:
    return _lines(
        "# A run of semlive. Look at it with: semlive doctor FILE, semlive plan FILE; then: semlive run FILE --attended",
        "# Keys that are left out have their defaults; a key that does not exist is refused, with the one that was meant.",
        "",
        "run:",
        (f"  name: {lab.name}", "names the log, <folder>/<name>/<name>.000.mcap; each run needs a new one"),
        ("  folder: runs", "where logs go, relative to this file: a disk of this computer, not a share"),
    )


def _sem(lab: LabSetup) -> str:
    vendor = () if lab.vendor == "other" else ((f"  vendor: {lab.vendor}", "a file counts only with this vendor's header"),)
    bar = ("    # databar_rows: 64", "px, rows of the databar below the image, if the microscope burns one in")
    times: Sequence[str | tuple[str, str]] = ()
    if lab.vendor == "other":
        times = (
            ("    dwell_time_s: 1.0e-4", "s, time on one pixel; plain files do not tell it"),
            ("    row_time_s: 0.1071", "s, from one row's start to the next, fly-back included"),
        )
    elif lab.vendor in ("tescan", "jeol", "hitachi"):
        times = (
            "    # these files do not tell all scan times: semlive inspect FILE says which are missing",
            ("    dwell_time_s: 1.0e-5", "s, time on one pixel; used where the file does not tell"),
            ("    row_time_s: 1.1e-2", "s, from one row's start to the next, fly-back included; used where the file does not tell"),
        )
    return _lines(
        "sem:",
        (f"  folder: {_quoted(lab.export_folder)}", "where the microscope's auto-save writes; a share is fine"),
        *vendor,
        (f"  pixel_size_um: {lab.pixel_size_um:g}", "um, edge of a pixel on the specimen; turns shifts in px into stage motion"),
        ("  poll_s: 1.0", "s, between looks into the folder"),
        ("  stable_for_s: 2.0", "s, a file is believed complete when it has stood still for so long"),
        "  profile:",
        ("    start_anchor: end", "what the time in the files marks: start or end of the scan, or save"),
        ("    start_sigma_s: 0.3", "s, standard uncertainty of the start that follows from it"),
        ("    clock_offset_s: 0", "s, the SEM's clock minus UTC, time zone included; semlive says what it finds"),
        *times,
        *((bar,) if lab.vendor in DATABAR_VENDORS else ()),
    )


def _load_frame(lab: LabSetup) -> str:
    if lab.frame == "none":
        return ""
    head: list[str | tuple[str, str]] = ["load_frame:"]
    if lab.frame == "modbus":
        host, _, port = lab.address.partition(":")
        head += [
            ("  driver: modbus", "one device behind Modbus, described by a register map"),
            ("  poll_s: 0.05", "s, between readings"),
            "  settings:",
            (f"    map: {lab.device_map}", "description of the device: semlive frame check MAP looks without moving"),
            (f"    host: {host}", "its address"),
            (f"    port: {port or 502}", "TCP port"),
            ("    unit: 1", "Modbus unit (slave) number"),
            ("    watchdog_s: 2.0", "s, the device stops by itself when it was not spoken to for so long"),
            ("    # confirmed: true", "when somebody has held the description beside the machine"),
        ]
    elif lab.frame == "serial":
        head += [
            ("  driver: ascii", "one device that speaks text over a serial line"),
            ("  poll_s: 0.2", "s, between readings"),
            "  settings:",
            (f"    map: {lab.device_map}", "description of the device: semlive frame check MAP looks without moving"),
            (f"    serial: {{port: {_quoted(lab.address)}}}", "its port; baud and parity are in the description"),
            ("    approach:", "how a stand that knows no load is brought to one, by short ways"),
            (
                f"      stiffness_n_mm: {lab.max_load_n:g}",
                "N/mm, of specimen, grips and stand in series: measure it; rather too high than too low",
            ),
            ("      speed_max_mm_s: 0.05", "mm/s, never faster"),
            ("      speed_min_mm_s: 0.0084", "mm/s, the slowest that the stand can do"),
            (f"      arrived_n: {load_tolerance_n(lab):g}", "N, this close to the target the motion is over"),
            ("    # confirmed: true", "when somebody has held the description beside the machine"),
        ]
    else:
        head += [
            ("  driver: operator", "closed software: a hand moves the frame when asked to"),
            ("  poll_s: 0.2", "s, between readings"),
            "  settings:",
            (f"    program: {lab.address}", "what the operator calls the maker's program"),
            (f"    arrived_n: {load_tolerance_n(lab):g}", "N, this close to the target the motion is over"),
            "    # load_file:                   # the file that the program records into; without it the operator types the load",
            "    #   {file: 'C:/microtest/*.csv', force: {column: Force, unit: N}, extension: {column: 3, unit: mm}}",
        ]
    return _lines(*head)


def load_tolerance_n(lab: LabSetup) -> float:
    """How close to its target a load is brought; one that is called arrived within the tolerance itself leaves it with the next reading."""
    fraction = {"modbus": 0.0025, "serial": 0.005}.get(lab.frame, 0.01)
    return max(fraction * lab.max_load_n, 0.1)


def _stage(lab: LabSetup) -> str:
    if lab.stage == "modbus":
        return _lines(
            "stage:",
            ("  driver: modbus", "the specimen's stage, or the beam's shift with kind: beam"),
            ("  settings: {host: 192.168.1.20, port: 502, unit: 1, kind: specimen}", "where it is reached, and what it moves"),
        )
    return _lines(
        "stage:",
        ("  driver: operator", "a hand moves the specimen: semlive says how far, and waits for Enter"),
        (f"  settings: {{um_per_px: {lab.pixel_size_um:g}}}", "um per px, so that it is asked in pixels too"),
    )


def _specimen(lab: LabSetup) -> str:
    return _lines(
        "specimen:",
        (f"  name: {_quoted(lab.specimen)}", "free text"),
        (f"  area_mm2: {lab.area_mm2:g}", "mm^2, cross-section; its uncertainty is yours to add to that of E"),
        (f"  loading_axis: {lab.loading_axis}", "the image axis that is pulled, x (columns) or y (rows)"),
    )


def _protocol(lab: LabSetup) -> str:
    unloaded: tuple[str | tuple[str, str], ...] = (
        "protocol:",
        ("  calibration_shifts_px:", "px, places of the unloaded pairs (x, y), both directions: they tell the distortion"),
        "    [[0, 0], [8, 0], [-16, 0], [0, 12], [24, 0], [0, -24], [-24, 0], [0, 24], [16, 8], [-8, -16], [0, 0]]",
        ("  translation_shifts_px: [[18, -11]]", "px, an unloaded check: its strain must come out as zero"),
    )
    hold = (
        ("  hold_s: 30", "s, rest before each pair"),
        ("  settle_s: 5", "s, so long load and stage must stay within tolerance to be called settled"),
        ("  stage_tolerance_um: 5", "um, allowed distance of the stage's own reading from its target"),
        ("  frame_timeout_s: 900", "s, no acceptable frame for so long while imaging is a fault; at least three scans"),
    )
    if not lab.loads_n:
        return _lines(*unloaded, *hold)
    rate = max(round(lab.max_load_n / 100, 2), 0.1)
    return _lines(
        *unloaded,
        (f"  loads_n: [{', '.join(f'{one:g}' for one in lab.loads_n)}]", "N, loads at which pairs are taken, tension positive"),
        (f"  ramp_rate_n_s: {rate:g}", "N/s, between loads"),
        (f"  load_tolerance_n: {2.0 * load_tolerance_n(lab):g}", "N, allowed distance of the load from its target"),
        *hold,
        "  # warm_up:                      # wait with the first load until the drift is slow",
        ("  #   max_rate_px_s: 0.005", "px/s, forecast drift rate plus its uncertainty"),
    )


def _limits(lab: LabSetup) -> str:
    if lab.frame == "none":
        return ""
    top, steps = lab.max_load_n, lab.loads_n
    largest = max(b - a for a, b in zip((0.0, *steps), steps, strict=False))
    return _lines(
        "limits:                           # checked on every command and every reading; the tighter of these and the device's own wins",
        (f"  force_min_n: {-0.025 * top:g}", "N, lowest allowed force"),
        (f"  force_max_n: {1.1 * top:g}", "N, highest allowed force: never what the specimen or the frame cannot bear"),
        ("  extension_min_mm: -0.5", "mm, lowest allowed crosshead extension"),
        ("  extension_max_mm: 2.0", "mm, highest allowed crosshead extension"),
        (f"  force_rate_max_n_s: {max(round(top / 40, 2), 0.3):g}", "N/s, fastest commanded ramp"),
        (f"  force_step_max_n: {1.2 * largest:g}", "N, largest commanded change of load in one step"),
        ("  stage_travel_um: 200", "um, largest allowed distance of the stage from where the run began"),
        (f"  force_drop_max_n: {max(0.1 * top, 1.0):g}", "N, a sudden fall by more stops: a slip, a fracture"),
        (f"  # unloaded_max_n: {0.055 * top:g}", "N, largest preload of the unloaded pairs; left out, 5 % of the larger force limit"),
    )


def _numerics() -> str:
    return _lines(
        "dic:",
        ("  subset_px: 43", "px, edge of a subset, odd; three speckles across at least"),
        ("  step_px: 5", "px, distance of neighbouring points"),
        ("  roi_px: [101, 101, 846, 696]", "px, first and last subset centre (x0, y0, x1, y1); null covers the frame"),
        "",
        "estimate:",
        ("  window_points: 9", "points, edge of the virtual strain gauge: (9 - 1) x 5 + 43 = 83 px"),
    )


def _lines(*lines: str | tuple[str, str]) -> str:
    """Return lines with aligned comments."""
    return "\n".join(line if isinstance(line, str) else f"{line[0]:<33} # {line[1]}" for line in lines)


def _quoted(text: str) -> str:
    return f'"{text}"' if any(one in text for one in " :#\\{}[]") else text
