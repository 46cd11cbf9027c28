"""One session with a TESCAN microscope: reads the settings of the scan, and scans one frame.

Commands that read: ``TcpGetVersion``, ``TcpGetDevice``, ``HVGetBeam``, ``ScGetBlanker``, ``ScGetExternal``, ``IsBusy``, ``GetViewField``
(mm, width of the scanning window), ``ScGetSpeed`` and ``ScEnumSpeeds`` (us), ``SMGetMode`` and ``SMEnumModes``, ``DtGetSelected`` and
``DtEnumDetectors``, ``EnumGeometries`` and ``GetGeometry``, ``ScGetTimeEstEx`` (s, from protocol 3.2.16 on), ``GUIGetScanning``.

Commands that change something: ``GUISetScanning`` (the live image is stopped for the scan, and started again after it), ``DtEnable`` (the
channel sends its data to this client), ``ScScanXY`` and ``ScStopScan``. No command moves the stage or changes the column.

Unconfirmed at a microscope: that ``ScGetTimeEstEx`` divided by the rows is the row time; the byte order of 16-bit data; that the window of
the scan is the entire field at any ratio of its sides. The manual demands an exclusive lock for a client that scans, and describes no
command for it; a scan of another client is only found by its wait flag.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass

from semlive.data.scan_report import ScanReading
from semlive.errors import LinkError
from semlive.ports import ClockSource
from semlive_drivers.microscope.frame_files import PendingFrame, tescan_header, write_image
from semlive_drivers.microscope.sharksem.assembly import FrameAssembly
from semlive_drivers.microscope.sharksem.connection import Connection
from semlive_drivers.microscope.sharksem.messages import Flag

OLDEST_PROTOCOL = (2, 0, 9)
"""Dwell time in ``ScScanXY`` since 2.0.6, ``IsBusy`` since 2.0.9."""
_TIME_ESTIMATE_PROTOCOL = (3, 2, 16)
_BEAM = {0: "its beam is off", -1: "its filament is blown"}
_BLANKED = 1
_MAX_GEOMETRIES = 16


@dataclass(frozen=True, slots=True)
class ScanRequest:
    """What is scanned.

    Attributes:
        width_px: columns.
        height_px: rows.
        channel: video channel whose data are taken.
        bits: 8 or 16 bits per pixel.
        dwell_time_us: time on a pixel; None: that of the scan speed which is set at the microscope.
        resume_live: start the live image again that was running before the scan.
    """

    width_px: int
    height_px: int
    channel: int
    bits: int
    dwell_time_us: float | None
    resume_live: bool


class SharkSemSession:
    """The Session of `semlive_drivers.microscope.trigger` over SharkSEM.

    Args:
        connection: open connection, closed by `close`.
        scan_request: what is scanned.
        clock: experiment time.
        frame: identification of the frame, sent back with its data.
        timeout_s: longest time until a frame is complete, s.

    Raises:
        LinkError: the protocol of the microscope is too old.
    """

    def __init__(self, connection: Connection, scan_request: ScanRequest, clock: ClockSource, frame: int, timeout_s: float) -> None:
        self._connection, self._scan_request, self._clock, self._frame, self._timeout_s = connection, scan_request, clock, frame, timeout_s
        version = connection.command("TcpGetVersion").text()
        self._version = tuple(int(part) if part.isdecimal() else 0 for part in version.split("."))
        if self._version < OLDEST_PROTOCOL:
            oldest = ".".join(map(str, OLDEST_PROTOCOL))
            raise LinkError(f"the microscope has SharkSEM {version[:20]!r}, the trigger needs {oldest} or later")
        self._device = connection.command("TcpGetDevice").text()[:80]
        self.name = f"TESCAN {self._device} (SharkSEM {version[:20]})"

    def read(self) -> ScanReading:
        """Read the settings of the scan; changes nothing.

        Raises:
            LinkError: the beam is off or blanked, the scan is external, stage or an automatic procedure are busy, or there is no answer.
        """
        self._require_ready()
        scan_request, field_mm = self._scan_request, self._connection.command("GetViewField").number()
        dwell_s = self._dwell_time_s()
        if not field_mm > 0 or not dwell_s > 0:
            raise LinkError(f"{self.name} reports a field of {field_mm:g} mm and a dwell time of {dwell_s:g} s; set them at the microscope")
        return ScanReading(
            time_ns=self._clock.now_ns(),
            dwell_time_s=dwell_s,
            row_time_s=self._row_time_s(dwell_s),
            field_width_m=field_mm * 1e-3,
            width_px=scan_request.width_px,
            height_px=scan_request.height_px,
            others=self._others(),
        )

    def scan(self, before: ScanReading, frame: PendingFrame) -> tuple[int, float | None]:
        """Scan one frame and write it; returns the end of the scan (experiment time, ns) and the measured row time, s.

        Raises:
            LinkError: the microscope refuses the scan, or its data are late, wrong or truncated.
        """
        command = self._connection.command
        was_live = command("GUIGetScanning").integer() == 1
        if was_live:
            command("GUISetScanning", 0)
        try:
            assembly = self._scan(before)
        finally:
            if was_live and self._scan_request.resume_live:
                # After a lost connection the live image cannot be started again; the error that is raised names the loss.
                with contextlib.suppress(LinkError):
                    command("GUISetScanning", 1)
        end_ns = self._clock.now_ns()
        write_image(frame, assembly.image())
        frame.sidecar = tescan_header(before, self._device, end_ns)
        return end_ns, assembly.row_time_s()

    def close(self) -> None:
        """Close both connections; never raises."""
        self._connection.close()

    def _scan(self, before: ScanReading) -> FrameAssembly:
        command, scan_request = self._connection.command, self._scan_request
        command("DtEnable", scan_request.channel, 1, scan_request.bits)
        width, height = scan_request.width_px, scan_request.height_px
        area = (width, height, 0, 0, width - 1, height - 1)
        dwell_ns = round(before.dwell_time_s * 1e9)
        stable = Flag.WAIT_SCAN | Flag.WAIT_OPTICS | Flag.WAIT_AUTOMATIC
        result = command("ScScanXY", self._frame, *area, 1, dwell_ns, wait=stable).integer()
        if result < 0:
            raise LinkError(f"{self.name} refused the scan of {width} x {height} px at {dwell_ns} ns (ScScanXY: {result})")
        assembly = FrameAssembly(self._frame, scan_request.channel, width, height, scan_request.bits)
        deadline_s = time.monotonic() + self._timeout_s
        try:
            while assembly.missing:
                try:
                    data = self._connection.image_data(deadline_s)
                except LinkError as error:
                    raise LinkError(f"{error}; {assembly.missing} of {width * height} pixels of the frame are missing") from error
                assembly.add(data, time.monotonic())
        except BaseException:
            with contextlib.suppress(LinkError):
                command("ScStopScan")
            raise
        # A scan must be stopped even if it ended; without the wait it would be ended early (manual, ScStopScan).
        command("ScStopScan", wait=Flag.WAIT_SCAN)
        return assembly

    def _require_ready(self) -> None:
        command = self._connection.command
        beam = command("HVGetBeam").integer()
        if beam != 1:
            raise LinkError(f"{self.name}: {_BEAM.get(beam, f'its beam has the state {beam}')}; switch it on, then resume")
        if command("ScGetBlanker").integer() == _BLANKED:
            raise LinkError(f"{self.name}: its beam is blanked; set the blanker to off or automatic, then resume")
        if command("ScGetExternal").integer() == 1:
            raise LinkError(f"{self.name}: its scan is external; give the scan back to the microscope, then resume")
        for flag, what in ((Flag.WAIT_STAGE, "its stage moves"), (Flag.WAIT_AUTOMATIC, "an automatic procedure is running")):
            if command("IsBusy", flag).integer() == 1:
                raise LinkError(f"{self.name}: {what}; let it end, then resume")

    def _dwell_time_s(self) -> float:
        command = self._connection.command
        if self._scan_request.dwell_time_us is not None:
            return self._scan_request.dwell_time_us * 1e-6
        speed = command("ScGetSpeed").integer()
        text = command("ScEnumSpeeds").map().get(f"speed.{speed}.dwell", "")
        try:
            return float(text) * 1e-6
        except ValueError:
            raise LinkError(f"{self.name} has no dwell time for its scan speed {speed}; set dwell_time_us of the trigger") from None

    def _row_time_s(self, dwell_s: float) -> float | None:
        if self._version < _TIME_ESTIMATE_PROTOCOL:
            return None
        width, height = self._scan_request.width_px, self._scan_request.height_px
        dwell_ns = round(dwell_s * 1e9)
        frame_s = self._connection.command("ScGetTimeEstEx", width, height, 0, 0, width - 1, height - 1, 1, dwell_ns).number()
        row_s = frame_s / height
        # A shorter time than that on the pixels would be refused with the frame: the estimate is then not that of a scan.
        return row_s if row_s >= width * dwell_s else None

    def _others(self) -> tuple[tuple[str, str], ...]:
        """Scan mode, detector and the geometric transformations of the scan, as text; rotation and tilt correction begin with degrees."""
        command = self._connection.command
        mode = command("SMGetMode").integer()
        others = [("scan mode", command("SMEnumModes").map().get(f"mode.{mode}.name", str(mode)))]
        detector = command("DtGetSelected", self._scan_request.channel).integer()
        detectors = command("DtEnumDetectors").map()
        numbers = [key.split(".")[1] for key, value in detectors.items() if key.endswith(".detector") and value == str(detector)]
        others.append(("detector", detectors.get(f"det.{numbers[0]}.name", str(detector)) if numbers else str(detector)))
        geometries = command("EnumGeometries").map()
        indices = [key.split(".")[1] for key in geometries if key.startswith("geom.") and key.endswith(".name")]
        for index in indices[:_MAX_GEOMETRIES]:
            if index.lstrip("-").isdecimal():
                answer = command("GetGeometry", int(index))
                values = [answer.number() for _ in range(2 if geometries.get(f"geom.{index}.count") == "2" else 1)]
                unit = geometries.get(f"geom.{index}.unit", "")
                text = " ".join(f"{value:.6g}" for value in values)
                others.append((_geometry_name(geometries[f"geom.{index}.name"]), f"{text} {unit}".strip()))
        return tuple(others)


def _geometry_name(name: str) -> str:
    """The name of a transformation in lower case; the rotation of the image, by any of its names, as ``rotation``."""
    lower = name.strip().lower()
    return "rotation" if "rotation" in lower else lower
