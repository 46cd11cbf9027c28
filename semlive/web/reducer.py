"""Reducer from the messages of a log to the state of the page: a pure function, one step per message."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

from semlive.engine import FINAL_STATES, Cause, OperatorCommand, State
from semlive.errors import BadInput
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import (
    TOPICS,
    ClockMessage,
    ClockOffsetMessage,
    FileMessage,
    LoadSampleMessage,
    LogLineMessage,
    OperatorMessage,
    PairMessage,
    RunMessage,
    ScanMessage,
    StageSampleMessage,
    StateMessage,
    from_json,
)
from semlive.formats.log.reader import LogMessage
from semlive.inputs.printable import printable
from semlive.ports import PromptEvent
from semlive.service.config.configuration import parse_config
from semlive.service.log import alarms as alarm_rules
from semlive.service.log.alarms import Alarm, AlarmLevel
from semlive.web.advice_texts import QUESTION_STATES, advice, advice_for
from semlive.web.downsampled_series import LoadRow, append
from semlive.web.fields import Fields
from semlive.web.page_state import FrameMaps, LogRow, LogRows, Notice, PageState, Question, RejectedFileRow, Run, ScanInfo
from semlive.web.result_reducers import RESULT_REDUCERS as RESULTS
from semlive.web.run_progress import with_pair, with_plan, with_state

_MAX_WARNINGS = 100
_MAX_ALARMS = 200
_MAX_REJECTED = 100
_MAX_LINES = 60
_MAX_QUALITY_ROWS = 4000


def reduce(view: PageState, message: LogMessage) -> PageState:
    """Return the state of the page after one more message; topics that are not shown change only the time of the last message.

    Raises:
        BadLog: the message does not have the form of its topic.
    """
    view = replace(view, earlier=replace(view.earlier, last_ns=message.log_time_ns))
    if message.topic not in _FOLLOWED or message.topic not in TOPICS:
        return view
    payload = from_json(message.topic, message.payload)
    view = _FOLLOWED[message.topic](view, payload)
    raised = alarm_rules.after(view.earlier.raised, payload)
    return view if raised is view.earlier.raised else _with_notices(replace(view, earlier=replace(view.earlier, raised=raised)))


def with_maps(view: PageState, fields: Fields) -> PageState:
    """Add the names and the correlation quality of the maps of a frame."""
    if fields.quality is not None:
        view = replace(view, quality=(*view.quality, fields.quality)[-_MAX_QUALITY_ROWS:])
    if not fields.values:
        return view
    before = {maps.frame: maps for maps in view.maps.frames}
    pair = fields.frame // 2
    step = view.schedule.done[pair] if pair < len(view.schedule.done) else None
    old = before.get(fields.frame)
    mapped = FrameMaps(
        fields.frame,
        "" if step is None else step.phase.value,
        None if step is None else step.load_n,
        tuple(dict.fromkeys((*(old.fields if old else ()), *fields.values))),
        old.version + 1 if old else 1,
        old is not None and old.image,
        fields.shift_px or (old.shift_px if old else None),
    )
    frames = tuple({**before, fields.frame: mapped}[number] for number in sorted({*before, fields.frame}))
    grid = fields.grid
    place = (grid.x0_px, grid.y0_px, grid.step_px, grid.nx, grid.ny, grid.subset_px)
    return replace(view, maps=replace(view.maps, frames=frames, grid=place))


def with_image(view: PageState, frame: int) -> PageState:
    """Mark that the image of a frame with maps is available."""
    frames = tuple(replace(maps, image=True) if maps.frame == frame else maps for maps in view.maps.frames)
    return replace(view, maps=replace(view.maps, frames=frames))


def seconds(view: PageState, time_ns: int) -> float:
    """Return seconds after the start of the run."""
    return 0.0 if view.run is None else round((time_ns - view.run.start_ns) / 1e9, 4)


def _run(view: PageState, message: RunMessage) -> PageState:
    try:
        config = parse_config(message.config, "the run's configuration")
        plan = config.plan()
    except BadInput:
        # A log of another version, or an imported one, still has content to show.
        progress = with_plan(view.progress, None, seconds(view, view.earlier.last_ns))
        return replace(view, run=_run_without_plan(message), boot_id=message.boot_id, progress=progress)
    gate, hold = plan.warm_up, plan.hold
    run = Run(
        name=message.run,
        host=message.host,
        version=message.versions.get("semlive", ""),
        start_ns=view.run.start_ns if view.run else message.started_time_ns,
        limits={} if config.limits is None else {name: value for name, value in asdict(config.limits).items() if value is not None},
        hold_s=hold.hold_s,
        max_hold_s=hold.hold_s if plan.adaptive_hold is None else plan.adaptive_hold.max_hold_s,
        settle_s=hold.settle_s,
        warm_up_rate_px_s=None if gate is None else gate.max_rate_px_s,
        warm_up_change_px_s=None if gate is None else gate.max_change_px_s,
        warm_up_wait_s=None if gate is None else gate.max_wait_s,
        area_mm2=config.specimen.area_mm2,
        loading_axis=config.specimen.loading_axis,
        pixel_um=config.sem.pixel_size_um,
        mask=config.dic.mask is not None,
    )
    progress = with_plan(view.progress, plan, seconds(view, view.earlier.last_ns))
    return replace(view, run=run, boot_id=message.boot_id, schedule=replace(view.schedule, planned=plan.steps), progress=progress)


def _run_without_plan(message: RunMessage) -> Run:
    return Run(
        message.run, message.host, message.versions.get("semlive", ""), message.started_time_ns, {}, 0.0, 0.0, 0.0, None, None, None, "y"
    )


def _clock(view: PageState, message: ClockMessage) -> PageState:
    return replace(view, clock=values.clock(message))


def _state(view: PageState, message: StateMessage) -> PageState:
    since_s = seconds(view, message.time_ns)
    hold_end_s = None if message.after != State.HOLDING or view.run is None else since_s + view.run.hold_s
    protocol = replace(
        view.protocol,
        state=message.after,
        cause=message.cause,
        step=message.step,
        since_s=since_s,
        hold_end_s=hold_end_s,
        advice=advice(message.after, message.cause),
        asks=message.after in QUESTION_STATES,
        guards={name: value for name, value in message.guards.items() if isinstance(value, float | int | str)},
    )
    measures = (view.schedule.measures and message.cause != Cause.PAIR_COMPLETE) or message.cause == Cause.MEASURE_AGAIN
    schedule = view.schedule if measures == view.schedule.measures else replace(view.schedule, measures=measures)
    view = _with_line(view, since_s, "state", f"{message.before} → {message.after}" + (f" ({message.cause})" if message.cause else ""))
    progress = with_state(view.progress, message.after, since_s)
    view = replace(view, protocol=protocol, schedule=schedule, drift=_gate(view, message), progress=progress)
    return replace(view, desk=replace(view.desk, questions=())) if message.after in FINAL_STATES else view


def _gate(view: PageState, message: StateMessage) -> Any:
    """Add the verdict of the warm-up gate to the drift panel."""
    rate, sigma, waited_s = (message.guards.get(name) for name in ("rate_px_s", "sigma_px_s", "waited_s"))
    drift = view.drift
    required = "" if view.run is None else view.run.warm_up_required
    if not required or not isinstance(rate, float | int) or not isinstance(sigma, float | int):
        return drift
    forecast = f"forecast {60 * rate:.2g} ± {60 * sigma:.1g} px/min"
    waited = f", waited {float(waited_s) / 60:.0f} min" if isinstance(waited_s, float | int) else ""
    if message.cause == Cause.WARMED_UP:
        return replace(drift, verdict=f"warm: {forecast}, {required}", warm=True)
    if message.cause == Cause.WARM_UP_ENDED:
        return replace(drift, verdict=f"not settled, and the run continues: {forecast}, {required}{waited}", warm=True)
    status = "too long" if message.cause == Cause.WARM_UP_TIMEOUT else "warming up"
    return replace(drift, verdict=f"{status}: {forecast}, {required}{waited}", warm=False)


def _load(view: PageState, message: LoadSampleMessage) -> PageState:
    row = LoadRow(seconds(view, message.time_ns), message.force_n, message.force_n, message.extension_mm, message.target_n)
    reading = replace(
        view.reading,
        force_n=message.force_n,
        extension_mm=message.extension_mm,
        target_n=message.target_n,
        motion=message.motion.value,
        gage_strain=message.gage_strain,
    )
    return replace(view, reading=reading, load=append(view.load, row))


def _stage(view: PageState, message: StageSampleMessage) -> PageState:
    return replace(view, reading=replace(view.reading, stage_um=(message.x_um, message.y_um)))


def _with_line(view: PageState, time_s: float, level: str, text: str) -> PageState:
    rows = (*view.lines.rows, LogRow(time_s, level, text))[-_MAX_LINES:]
    return replace(view, lines=LogRows(rows, view.lines.count + 1))


def _line(view: PageState, message: LogLineMessage) -> PageState:
    view = _with_line(view, seconds(view, message.time_ns), message.level, printable(message.text.strip().rpartition("\n")[2]))
    if message.level == "info":
        return replace(view, protocol=replace(view.protocol, message=printable(message.text)))
    lines = message.text.strip().splitlines()
    # The text of an error can be a stack trace, whose last line is the message.
    return _warned(view, message.time_ns, message.level, lines[-1] if lines and message.level == "error" else message.text.strip(), "")


def _offset(view: PageState, message: ClockOffsetMessage) -> PageState:
    return _warned(view, view.earlier.last_ns, "warning", message.reason, message.advice) if message.advice else view


def _warned(view: PageState, time_ns: int, level: str, text: str, what_to_do: str) -> PageState:
    notice = Notice(seconds(view, time_ns), level, printable(text), what_to_do)
    warnings = (*view.earlier.warnings, notice)[-_MAX_WARNINGS:]
    return _with_notices(replace(view, earlier=replace(view.earlier, warnings=warnings)))


def _with_notices(view: PageState) -> PageState:
    """Merge alarms and warnings; an open alarm about a disobeyed stop is shown regardless of later entries."""
    alarms = view.earlier.raised.listed
    shown = (*(notice for notice in alarms[:-_MAX_ALARMS] if notice.disobeyed and not notice.acknowledged), *alarms[-_MAX_ALARMS:])
    notices = sorted((*view.earlier.warnings, *(_notice(view, alarm) for alarm in shown)), key=lambda notice: notice.time_s)
    return replace(view, alarms=tuple(notices))


def _notice(view: PageState, alarm: Alarm) -> Notice:
    return Notice(
        seconds(view, alarm.time_ns),
        "error" if alarm.level is AlarmLevel.DANGER else "warning",
        alarm.text if alarm.where in ("", "run") else f"{alarm.where}: {alarm.text}",
        advice_for(alarm.kind, alarm.code) or f"semlive: {alarm.action}.",
        alarm.identity,
        alarm.code,
        None if alarm.acknowledged_ns is None else seconds(view, alarm.acknowledged_ns),
        alarm.acknowledged_by,
        alarm.disobeyed and not alarm.acknowledged,
    )


def _only_alarms(view: PageState, _: object) -> PageState:
    return view


def _file(view: PageState, message: FileMessage) -> PageState:
    frames, time_s = view.frames, seconds(view, view.earlier.last_ns)
    name = printable(message.name)
    if message.decision == "arrived":
        return replace(view, frames=replace(frames, newest=message.export, name=name, time_s=time_s, arrived=frames.arrived + 1))
    if message.decision != "refused":
        return view
    newest = RejectedFileRow(time_s, name, printable(message.reason))
    rejected = (newest, *frames.refused)[:_MAX_REJECTED]
    return replace(view, frames=replace(frames, refused=rejected, refused_count=frames.refused_count + 1))


def _scan(view: PageState, message: ScanMessage) -> PageState:
    """Take scan time and pixel size of the newest file; the configured pixel size is the fallback."""
    pixel_um = 1e6 * message.pixel_size_m.value if message.pixel_size_m.value else None
    scan_s = message.frame_time_s.value or None
    scan = ScanInfo(pixel_um, scan_s, (message.width_px, message.height_px))
    progress = view.progress if scan_s is None or view.progress.scan_s == scan_s else replace(view.progress, scan_s=scan_s)
    return replace(view, scan=view.scan if scan == view.scan else scan, progress=progress)


def _pair(view: PageState, message: PairMessage) -> PageState:
    done = (*view.schedule.done[: message.pair], message.step)
    frames = replace(view.frames, paired=2 * len(done))
    loads = {2 * message.pair + member: load.mean_n for member, load in enumerate(message.loads or ())}
    panel = replace(view.desk, told="") if view.desk.told else view.desk
    schedule = replace(view.schedule, done=done)
    earlier = replace(view.earlier, frame_loads={**view.earlier.frame_loads, **loads})
    planned = len([step for step in done if not step.warm_up])
    progress = with_pair(view.progress, planned, seconds(view, view.earlier.last_ns))
    return replace(view, schedule=schedule, frames=frames, desk=panel, earlier=earlier, progress=progress)


def _operator(view: PageState, message: OperatorMessage) -> PageState:
    text, question = str(message.args.get("text", "")), str(message.args.get("question", ""))
    panel = view.desk
    open_questions = tuple(item for item in panel.questions if item.question != question)
    if message.what == PromptEvent.PROMPT:
        prompt = Question(question, text, str(message.args.get("wanted", "")))
        return replace(view, desk=replace(panel, questions=(*open_questions, prompt), told=""))
    if message.what in (PromptEvent.RESPONSE, PromptEvent.WITHDRAWN):
        return replace(view, desk=replace(panel, questions=open_questions, told=""))
    if message.what == PromptEvent.MESSAGE:
        return replace(view, desk=replace(panel, told=text))
    return view if message.what not in list(OperatorCommand) else replace(view, desk=replace(panel, told=""))


_FOLLOWED: Mapping[str, Callable[[PageState, Any], PageState]] = {
    "/run": _run,
    "/clock": _clock,
    "/clock/offset": _offset,
    "/state": _state,
    "/load_frame/sample": _load,
    "/stage/sample": _stage,
    "/log": _line,
    "/fault": _only_alarms,
    "/sem/file": _file,
    "/sem/scan": _scan,
    "/pair": _pair,
    "/operator": _operator,
    **RESULTS,
}
