"""The daemon: start-up, the loop, shutdown. Whatever happens, the frame is stopped and the log is finished."""

from __future__ import annotations

import asyncio
import contextlib
import os
import platform
import queue
import signal
import socket
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from semlive.data.loading import DeviceIdentity
from semlive.engine import Device, DeviceFault, Finish, State, Verb
from semlive.errors import BadConfig, SemliveError
from semlive.formats import message_values as values
from semlive.formats.messages import RunMessage
from semlive.ports import Trigger
from semlive.service import drivers
from semlive.service.analysis_link import AnalysisLink
from semlive.service.clock import FileClock, SystemClock, open_clock
from semlive.service.config import Config
from semlive.service.control import Control, Snapshot
from semlive.service.journal import Journal
from semlive.service.link import LinkThread
from semlive.service.log_files import segment_path
from semlive.service.record import Recorder
from semlive.service.watch import FolderWatcher, WatchSettings

_TICK_S = 0.05
_OPEN_TIMEOUT_S = 10.0
# The last pairs may still be correlated when the protocol ends; a second each on a slow machine.
_ANALYSIS_TIMEOUT_S = 120.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run ended.

    Attributes:
        log: run folder.
        complete: every step was done.
        text: one sentence.
    """

    log: Path
    complete: bool
    text: str


@dataclass(frozen=True, slots=True)
class Faces:
    """Who looks at a run and speaks to it.

    Attributes:
        observe: gets a snapshot with every tick, in the loop; must not block.
        verbs: what the operator says, from any thread.
        attended: somebody stays at the instrument.
        stop_on_fault: end the run at a fault instead of waiting for the operator.
    """

    observe: Callable[[Snapshot], None]
    verbs: queue.SimpleQueue[Verb]
    attended: bool = False
    stop_on_fault: bool = False


def run_experiment(config: Config, faces: Faces) -> Outcome:
    """Run an experiment from start-up to the finished log.

    Raises:
        BadInput: configuration, folder or socket are not as they must be; nothing was moved.
        SemliveError: the run could not be started or finished.
    """
    return asyncio.run(_Daemon(config, faces).run())


class _Daemon:
    def __init__(self, config: Config, faces: Faces) -> None:
        self._config, self._faces = config, faces
        self._folder = config.run.folder / config.run.name
        self._signals = 0
        self._control: Control | None = None

    async def run(self) -> Outcome:
        clock = open_clock(self._config.run.clock_file)
        watch = WatchSettings(folder=self._config.sem.folder, poll_s=self._config.sem.poll_s, stable_for_s=self._config.sem.stable_for_s)
        if not watch.folder.is_dir():
            raise BadConfig(f"sem.folder {watch.folder}: no such folder; create it or correct the path")
        with contextlib.ExitStack() as stack:
            journal, recorder = self._open_log(stack, clock)
            loop = asyncio.get_running_loop()
            self._control = control = Control(self._config.plan(), clock, journal, self._faces.observe)
            stack.callback(control.close)
            stack.enter_context(self._signals_to(control))
            analysis = AnalysisLink(
                self._folder,
                recorder.flush_wait,
                lambda message: control.soon(control.output, message),
                lambda what, lost: control.soon(_analysis_trouble, control, clock, what, lost),
            )
            stack.callback(analysis.close, 5.0)
            journal.follow(analysis.give)
            journal.note(self._run_message(clock))
            journal.note(values.clock_message(clock.current(), "start of the run"))
            links, trigger = self._links(control, clock), self._open_trigger(clock)
            for link in links.values():
                stack.callback(link.close)
            control.connect(links, trigger)
            identities = {device: await loop.run_in_executor(None, link.open, _OPEN_TIMEOUT_S) for device, link in links.items()}
            self._check_attended(identities)
            watcher = FolderWatcher(
                watch,
                clock,
                lambda file: control.soon(control.exported, file),
                lambda refused: control.soon(control.refused, refused.name, refused.reason),
                lambda what: control.soon(control.trouble, what, "export folder", "kept trying"),
            )
            stack.callback(watcher.close)
            finish = await self._loop(control, watcher, identities)
            watcher.close()
            for link in links.values():
                await loop.run_in_executor(None, link.close)
            await loop.run_in_executor(None, analysis.close, _ANALYSIS_TIMEOUT_S)
            await asyncio.sleep(0)
            if not await loop.run_in_executor(None, recorder.close):
                raise SemliveError(f"{recorder.part}: the log could not be finished; make room on the disk, what was written is in it")
        return Outcome(self._folder, finish.outcome is State.COMPLETE, finish.text)

    async def _loop(self, control: Control, watcher: FolderWatcher, identities: Mapping[Device, DeviceIdentity]) -> Finish:
        ready = asyncio.ensure_future(control.analysis_ready.wait())
        started = False
        try:
            while not control.finished.done():
                while not self._faces.verbs.empty():
                    control.operator(self._faces.verbs.get())
                if not started and ready.done():
                    started = True
                    watcher.start()
                    control.ready(identities.get(Device.LOAD_FRAME), identities.get(Device.STAGE))
                control.tick()
                if control.troubled.is_set() and self._faces.stop_on_fault:
                    control.troubled.clear()
                    control.operator(Verb.STOP)
                await asyncio.sleep(_TICK_S)
        finally:
            ready.cancel()
        return control.finished.result()

    def _open_log(self, stack: contextlib.ExitStack, clock: SystemClock | FileClock) -> tuple[Journal, Recorder]:
        try:
            self._folder.mkdir(parents=True)
        except FileExistsError:
            raise BadConfig(f"{self._folder}: this run exists already; give run.name another name") from None
        except OSError as error:
            raise BadConfig(f"{self._folder}: cannot be created ({error.strerror}); correct run.folder") from error
        recorder = Recorder(segment_path(self._folder, self._config.run.name, 0), clock, self._disk_trouble)
        stack.callback(recorder.close)
        return Journal(recorder), recorder

    def _disk_trouble(self, what: str) -> None:
        """In the recorder's thread."""
        if self._control is not None:
            self._control.soon(self._control.trouble, what, "log", "kept in memory and tried again")

    def _links(self, control: Control, clock: SystemClock | FileClock) -> dict[Device, LinkThread]:
        frame, stage, plan = self._config.load_frame, self._config.stage, self._config.plan()
        links = {}
        if frame is not None:
            links[Device.LOAD_FRAME] = LinkThread(
                Device.LOAD_FRAME,
                lambda: drivers.open_load_frame(frame.driver, frame.settings, clock),
                control.from_link,
                clock=clock,
                limits=plan.limits,
                poll_s=frame.poll_s,
            )
        if stage is not None:
            links[Device.STAGE] = LinkThread(
                Device.STAGE,
                lambda: drivers.open_stage(stage.driver, stage.settings, clock),
                control.from_link,
                clock=clock,
                limits=plan.limits,
                poll_s=stage.poll_s,
            )
        return links

    def _open_trigger(self, clock: SystemClock | FileClock) -> Trigger | None:
        trigger = self._config.sem.trigger
        return None if trigger is None else drivers.open_trigger(trigger.driver, trigger.settings, clock)

    def _check_attended(self, identities: Mapping[Device, DeviceIdentity]) -> None:
        for device, identity in identities.items():
            if not identity.simulated and not self._faces.attended:
                raise BadConfig(
                    f"{device.words} {identity.name}: is a real machine, and unattended runs are not released yet; "
                    f"give --attended and stay at the instrument"
                )

    def _run_message(self, clock: SystemClock | FileClock) -> RunMessage:
        versions = {name: version(name) for name in ("semlive", "numpy", "scipy", "numba", "mcap")}
        return RunMessage(
            run=self._config.run.name,
            started_time_ns=clock.now_ns(),
            started_mono_ns=clock.mono_ns(),
            boot_id=_boot_id(),
            host=socket.gethostname(),
            versions={**versions, "python": platform.python_version()},
            config=self._config.model_dump(mode="json"),
        )

    @contextlib.contextmanager
    def _signals_to(self, control: Control) -> Iterator[None]:
        """First Ctrl-C or SIGTERM: stop and finish. Second: abort."""

        def asked(*_: object) -> None:
            self._signals += 1
            control.soon(control.operator, Verb.STOP if self._signals == 1 else Verb.ABORT)

        before = {number: signal.signal(number, asked) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def _analysis_trouble(control: Control, clock: SystemClock | FileClock, what: str, lost: bool) -> None:
    control.trouble(what, "analysis", "stopped" if lost else "started another that catches up from the log")
    if lost:
        control.handle(DeviceFault(clock.now_ns(), Device.SEM, "the analysis process is lost, so frames cannot be judged"))


def _boot_id() -> str:
    path = Path("/proc/sys/kernel/random/boot_id")
    return path.read_text(encoding="ascii").strip() if os.name == "posix" and path.exists() else ""
