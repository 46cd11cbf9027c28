"""A run that is acted: a log with everything that a page shows, which enters one state after the other, and its page.

python tests/browser/staged_run.py FOLDER     # writes the screenshots of the documentation (docs/live-page)
"""

from __future__ import annotations

import asyncio
import queue
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.experiment import Phase, Step
from semlive.data.frame import FrameInfo
from semlive.data.grid import Grid
from semlive.data.loading import FrameLoad, MotionState
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.strain import Displacement, MeasuredValue, StrainField, Tensor2
from semlive.engine import OperatorCommand
from semlive.formats.log.foxglove import SEM_IMAGE, compressed_image
from semlive.formats.log.maps import encode_displacement, encode_map, encode_strain
from semlive.formats.log.messages import (
    DIC_MAP,
    DISPLACEMENT_FIELD,
    SEM_ORIGINAL,
    STRAIN_FIELD,
    ClockMessage,
    DriftForecastMessage,
    DriftMessage,
    ElasticMessage,
    FaultMessage,
    FileMessage,
    LoadSampleMessage,
    LogLineMessage,
    OperatorMessage,
    PairMessage,
    RunMessage,
    ScanMessage,
    StateMessage,
    StrainMessage,
    topic_of,
)
from semlive.inputs.mask_file import embedded_mask
from semlive.service.control.socket import SocketAddress, token_digest
from semlive.service.log.files import segment_path
from semlive.service.log.recording import Recorder
from semlive.service.runtime.clock import SystemClock, boot_id

sys.path.insert(0, str(Path(__file__).parent))
from guarded_run import listen, page_of

LOADS_N = (200.0, 500.0, 800.0, 1100.0)
STEP_S, SCAN_S, HOLD_S = 240.0, 80.0, 60.0
WIDTH_PX, HEIGHT_PX, AREA_MM2, MODULUS_GPA = 640, 480, 10.0, 70.0
GRID = Grid(60, 60, 10, 53, 37, 41)
HOLE_PX = (500, 120, 36)
"""Centre and radius of a hole of the specimen, which the mask excludes."""


def hole_mask() -> NDArray[np.uint8]:
    """(height, width) 0 in the hole."""
    x, y, radius = HOLE_PX
    return cv2.circle(np.full((HEIGHT_PX, WIDTH_PX), 255, dtype=np.uint8), (x, y), radius, 0.0, -1).astype(np.uint8)


CONFIG: dict[str, Any] = {
    "dic": {"mask": embedded_mask(cv2.imencode(".png", hole_mask())[1].tobytes(), "hole.png")},
    "sem": {
        "folder": ".",
        "pixel_size_um": 0.5,
        "profile": {"dwell_time_s": SCAN_S / WIDTH_PX / HEIGHT_PX, "row_time_s": SCAN_S / HEIGHT_PX, "pixel_size_m": 0.5e-6},
    },
    "stage": {"driver": "operator"},
    "load_frame": {"driver": "null"},
    "limits": dict(force_min_n=-50.0, force_max_n=1200.0, extension_min_mm=-0.2, extension_max_mm=1.0, force_rate_max_n_s=50.0)
    | dict(force_step_max_n=900.0, stage_travel_um=100.0),
    "specimen": {"area_mm2": AREA_MM2},
    "protocol": {"loads_n": [*LOADS_N], "calibration_shifts_px": [[0, 0], [12, 12]], "hold_s": HOLD_S, "settle_s": 5.0},
}
STEPS = (
    Step(0, Phase.CALIBRATION, (0.0, 0.0), (0.0, 0.0), None),
    Step(1, Phase.CALIBRATION, (6.0, 6.0), (12.0, 12.0), None),
    *(Step(2 + number, Phase.TENSION, (0.0, 0.0), (0.0, 0.0), load_n) for number, load_n in enumerate(LOADS_N)),
)
Array = NDArray[np.float64]


@dataclass
class StagedRun:
    """The log, the page and what the control socket received. Times are seconds after the start of the run."""

    port: int
    control: SocketAddress
    recorder: Recorder
    start_ns: int
    heard: list[tuple[OperatorCommand | str, str]] = field(default_factory=list)
    state: str = "idle"
    alarm: str = ""

    @property
    def address_with_token(self) -> str:
        return f"http://127.0.0.1:{self.port}/#token={self.control.token}"

    def _at(self, seconds: float) -> int:
        return self.start_ns + round(1e9 * seconds)

    def write(self, payload: Any, seconds: float) -> None:
        self.recorder.write(topic_of(payload), payload, self._at(seconds))

    def _enter(self, state: str, seconds: float, step: int, cause: str = "next_step") -> None:
        self.write(StateMessage(time_ns=self._at(seconds), before=self.state, after=state, cause=cause, step=step, guards={}), seconds)
        self.state = state
        self.recorder.flush()

    def _log_line(self, text: str, seconds: float, level: str = "info") -> None:
        self.write(LogLineMessage(time_ns=self._at(seconds), level=level, text=text), seconds)

    def _load(self, seconds: float, force_n: float, target_n: float, motion: MotionState = MotionState.STOPPED) -> None:
        reading = LoadSampleMessage(
            sequence=0, time_ns=self._at(seconds), mono_ns=0, force_n=force_n, extension_mm=force_n / 4000.0, motion=motion,
            target_n=target_n, raw=(),
        )  # fmt: skip
        self.write(reading, seconds)

    def _begin(self) -> None:
        """The devices are being connected."""
        clock = ClockMessage(mono_ns=0, utc0_ns=time.time_ns(), mono0_ns=time.monotonic_ns(), rate=1.0, revision=0, reason="start")
        run = RunMessage(
            run="al-5754-tension",
            started_time_ns=self.start_ns,
            host="sem-lab",
            boot_id=boot_id(),
            versions={"semlive": "0.2.0"},
            config=CONFIG,
        )
        self.write(run, 0.0)
        self.write(clock, 0.0)
        self._enter("connecting", 0.0, 0, "opening")
        self._log_line("connecting to load frame and stage", 0.0)

    def _pair(self, number: int) -> None:
        """One complete step: motion, hold, two frames, results."""
        step, begin = STEPS[number], STEP_S * number
        before_n, load_n = STEPS[number - 1].load_n or 0.0 if number else 0.0, step.load_n or 0.0
        self._enter("ramping", begin + 1.0, number)
        self._log_line(f"step {number + 1} of {len(STEPS)}: {step.phase}, load {load_n:g} N", begin + 1.0)
        for part in np.linspace(0.0, 1.0, 8):
            self._load(begin + 1.0 + 8.0 * part, before_n + part * (load_n - before_n), load_n, MotionState.MOVING)
        self._enter("holding", begin + 15.0, number, "settled")
        self._enter("imaging", begin + 15.0 + HOLD_S, number, "hold_over")
        for member in (0, 1):
            self._file(2 * number + member, begin + 75.0 + SCAN_S * (member + 1))
            self._load(begin + 75.0 + SCAN_S * (member + 1), load_n - 0.4 * member, load_n)
        self._enter("step_done", begin + 236.0, number, "pair_complete")
        self._complete(number, begin + 236.0)

    def _complete(self, number: int, seconds: float) -> None:
        """The pair of a step, and its results."""
        load_n = STEPS[number].load_n or 0.0
        load = FrameLoad(load_n, load_n, load_n, 0.2)
        first, second = (info(2 * number + member) for member in (0, 1))
        self.write(PairMessage(pair=number, step=STEPS[number], first=first, second=second, loads=(load, load)), seconds)
        self._results(number, load_n, seconds)

    def _file(self, export: int, seconds: float) -> None:
        name = f"scan_{export:04d}.tif"
        arrived = FileMessage(
            export=export, name=name, size=1, sha256="", mtime_ns=0, arrival_time_ns=self._at(seconds), decision="arrived", reason=""
        )
        self.recorder.write(SEM_ORIGINAL, cv2.imencode(".tif", speckle())[1].tobytes(), self._at(seconds), export)
        self.write(arrived, seconds)
        timing = info(export).timing
        scan = ScanMessage(
            frame=export, export=export, name=name, vendor="plain", width_px=WIDTH_PX, height_px=HEIGHT_PX, databar_rows=0,
            dwell_time_s=timing.dwell_time_s, row_time_s=timing.row_time_s, frame_time_s=timing.frame_time_s,
            integrations=timing.integrations, start_time_ns=Sourced(self._at(seconds - SCAN_S), Provenance.CONFIG), start_sigma_s=0.0,
            end_time_ns=self._at(seconds),
            pixel_size_m=Sourced(0.5e-6, Provenance.CONFIG),
        )  # fmt: skip
        self.write(scan, seconds)

    def _results(self, number: int, load_n: float, end: float) -> None:
        """Maps, strain, drift and elastic constants after a pair."""
        axial = load_n / AREA_MM2 / MODULUS_GPA * 1e-3
        draw = np.random.default_rng(number)
        for frame in (2 * number, 2 * number + 1):
            exx, eyy, exy = strains(axial, draw)
            u, v = displacements(exx, eyy)
            sigma, valid = np.full_like(u, 0.012), np.ones(u.shape, dtype=bool)
            valid[:2, :3] = False
            x, y = GRID.mesh()
            valid[np.hypot(x - HOLE_PX[0], y - HOLE_PX[1]) < HOLE_PX[2] + 5] = False
            status = np.where(valid, PoiStatus.CONVERGED, PoiStatus.LOW_ZNCC).astype(np.uint8)
            drifted = 0.05 * frame
            if frame:
                maps = DisparityMap(0, frame, GRID, u + drifted, v - drifted, sigma, sigma, np.full_like(u, 0.983), status)
                self.recorder.write(DIC_MAP, encode_map(maps), self._at(end), frame)
            noise = draw.normal(0.0, 0.012, u.shape)
            moved = Displacement(frame, GRID, u + noise, v - noise, sigma, sigma, valid)
            self.recorder.write(DISPLACEMENT_FIELD, encode_displacement(moved), self._at(end), frame)
            self.recorder.write(STRAIN_FIELD, encode_strain(StrainField(frame, GRID, 9, exx, eyy, exy, valid)), self._at(end), frame)
            self.recorder.write(SEM_IMAGE, compressed_image(speckle(), self._at(end), f"frame {frame}"), self._at(end), frame)
            spread = Tensor2(9e-5, 9e-5, 6e-5)
            mean = Tensor2(-0.33 * axial, axial, 0.0)
            strain = StrainMessage(
                revision=number, frame=frame, mean=mean, mean_sigma=Tensor2(1e-5, 1e-5, 1e-5), sd=spread, vsg_px=83.0, gauge_sigma=spread
            )
            self.write(strain, end)
        self.write(drift(number), end)
        if number >= 3:
            modulus, ratio = MeasuredValue(70.4, 3.2 / number), MeasuredValue(0.332, 0.05 / number)
            self.write(ElasticMessage(revision=number, pairs=number + 1, youngs_modulus_gpa=modulus, poissons_ratio=ratio), end)

    def show(self, state: str) -> None:
        """Enter one of `STATES`; they follow each other in this order. What charts draw has the same times in each run."""
        now = 4.0 * STEP_S
        if state == "starting":
            self._begin()
        elif state == "ramp":
            for number in range(4):
                self._pair(number)
            self._enter("ramping", now + 3.0, 4)
            self._log_line("step 5 of 6: tension, load 800 N", now + 3.0)
            self._load(now + 12.0, 618.0, 800.0, MotionState.MOVING)
        elif state == "hold":
            self._load(now + 20.0, 799.6, 800.0)
            now_s = (time.time_ns() - self.start_ns) / 1e9
            self._enter("holding", now_s - 13.0, 4, "settled")
        elif state == "imaging":
            self._enter("imaging", self._now_s(), 4, "hold_over")
        elif state == "paused":
            self._log_line("paused by page at 127.0.0.1", self._now_s())
            self._enter("paused", self._now_s(), 4, "pause")
        elif state == "question":
            self._enter("ramping", self._now_s(), 4, "resume")
            requests = {"text": "in MICROTEST, bring the load to 800 N; type the load in N and press enter when it is there"}
            prompt = OperatorMessage(
                time_ns=self._at(self._now_s()), what="asked", args={**requests, "question": "terminal.1", "wanted": "load_n"}
            )
            self.write(prompt, self._now_s())
        elif state == "fault":
            now_s = self._now_s()
            args = {"text": "", "question": "terminal.1"}
            self.write(OperatorMessage(time_ns=self._at(now_s), what="taken_back", args=args), now_s)
            self._load(now + 60.0, 1207.3, 800.0, MotionState.STOPPED)
            text, action, time_ns = "the load 1207.3 N is beyond its limit of 1200 N", "motion was stopped and is held", self._at(now_s)
            self.write(FaultMessage(time_ns=time_ns, what=text, where="load frame", action=action, code="limit"), now_s)
            self.alarm = str(time_ns)
            self._log_line(text, now_s)
            self._enter("fault", now_s, 4, "limit")
        elif state == "finished":
            now_s = self._now_s()
            args = {"alarm": self.alarm, "by": "terminal"}
            self.write(OperatorMessage(time_ns=self._at(now_s), what="acknowledge", args=args), now_s)
            self._load(now + 120.0, 1099.7, 1100.0)
            for number in (4, 5):
                self._complete(number, now_s)
            self._log_line("all 6 steps are done; load and position are held", now_s)
            self._enter("complete", now_s, 5, "last_step")
        self.recorder.flush()

    def _now_s(self) -> float:
        return (time.time_ns() - self.start_ns) / 1e9


STATES = ("starting", "ramp", "hold", "imaging", "paused", "question", "fault", "finished")


def speckle() -> NDArray[np.uint8]:
    """A speckle pattern of the size of a frame."""
    draw = np.random.default_rng(5)
    blurred = cv2.GaussianBlur(draw.normal(size=(HEIGHT_PX, WIDTH_PX)), (0, 0), 2.2)
    return np.clip(128 + 420 * blurred, 20, 235).astype(np.uint8)


def strains(axial: float, draw: np.random.Generator) -> tuple[Array, Array, Array]:
    """Strains next to a hole in the middle."""
    y, x = np.mgrid[-1.0 : 1.0 : GRID.ny * 1j, -1.0 : 1.0 : GRID.nx * 1j]
    concentration = axial * (1.0 + 0.9 * np.exp(-((np.abs(x) - 0.35) ** 2 / 0.05 + y**2 / 0.08)))
    noise = cv2.GaussianBlur(draw.normal(0.0, 6e-4, (3, GRID.ny, GRID.nx)).transpose(1, 2, 0), (0, 0), 1.5).transpose(2, 0, 1)
    return -0.33 * concentration + noise[0], concentration + noise[1], 0.2 * axial * x * y + noise[2]


def displacements(exx: Array, eyy: Array) -> tuple[Array, Array]:
    """Displacements of these strains, px."""
    u, v = np.cumsum(exx, axis=1) * GRID.step_px, np.cumsum(eyy, axis=0) * GRID.step_px
    return u - u.mean(), v - v.mean()


def drift(number: int) -> DriftMessage:
    frames = [frame for frame in range(2 * number + 2) for _ in range(3)]
    times = [SCAN_S * frame + 25.0 * (at % 3) for at, frame in enumerate(frames)]
    points = tuple((1.1e-3 * t + 0.02 * np.sin(t / 60.0), -1.6e-3 * t) for t in times)
    sigma = tuple((0.02, 0.02) for _ in times)
    ahead = DriftForecastMessage(
        time_s=(times[-1] + 30.0, times[-1] + 110.0), duration_s=SCAN_S, rate_px_s=((0.0011, -0.0016),) * 2, sigma_px_s=((2e-4, 2e-4),) * 2
    )
    return DriftMessage(
        revision=number, time_s=tuple(times), frame=tuple(frames), drift_px=points, sigma_px=sigma, rate_px_s=sigma, forecast=ahead
    )


def info(export: int) -> FrameInfo:
    def stated(value: Any) -> Sourced[Any]:
        return Sourced(value, Provenance.CONFIG)

    timing = ScanTiming(stated(SCAN_S / WIDTH_PX / HEIGHT_PX), stated(SCAN_S / HEIGHT_PX), stated(SCAN_S), stated(1))
    return FrameInfo(export, f"scan_{export:04d}.tif", "plain", WIDTH_PX, HEIGHT_PX, 0, timing, stated(0), 0.0, stated(0.5e-6))


@contextmanager
def staged_run(folder: Path) -> Iterator[StagedRun]:
    """A run before its start, its control socket and its page, in a folder."""
    heard: list[tuple[OperatorCommand | str, str]] = []
    opened: queue.Queue[tuple[SocketAddress, Any]] = queue.Queue()
    listening = threading.Thread(target=lambda: asyncio.run(listen(heard, opened.put)))
    listening.start()
    control, leave = opened.get(timeout=60)
    recorder = Recorder(segment_path(folder, "run", 0), SystemClock(), lambda _: None)
    process = page_of(folder, "--control", str(control.port), "--token-sha256", token_digest(control.token))
    assert process.stdout is not None
    # The start of the run is set so that its first four steps end now.
    start_ns = time.time_ns() - round(1e9 * (4.0 * STEP_S + 40.0))
    try:
        yield StagedRun(int(process.stdout.readline()), control, recorder, start_ns, heard)
    finally:
        process.communicate()
        recorder.close()
        leave()
        listening.join()
