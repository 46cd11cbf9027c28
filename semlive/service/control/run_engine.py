"""The engine of a run: each event is written to the log, passed to the engine, and the resulting commands are executed.

Theory of operation
-------------------
`handle` is the only place that changes the state of the engine. It runs in the loop of control, never blocks and is never nested: the
execution of a command raises no event. After a final state events are only recorded.
"""

from __future__ import annotations

from semlive.data.faults import FaultCode
from semlive.engine import (
    FINAL_STATES,
    DeviceFault,
    DeviceStopped,
    EngineState,
    Event,
    LinkLost,
    LoadReading,
    StageReading,
    State,
    progress,
    step,
)
from semlive.ports import ClockSource
from semlive.service.control.command_dispatcher import CommandDispatcher
from semlive.service.control.run_monitor import RunMonitor
from semlive.service.log.run_log import RunLog

_FAULT_STATES = (State.FAULT, State.EMERGENCY_STOP)
_ENDING_STATES = (State.STOPPING, *FINAL_STATES)
_WARNING_EVENTS = (DeviceFault, DeviceStopped, LinkLost)


class RunEngine:
    """State of the engine, with the record of its events and the reason of its faults.

    Args:
        state: state at the start of the run.
        clock: experiment time.
        journal: the log of the run.
        dispatcher: executes the commands.
        monitor: warnings and the reason of a stop.
    """

    def __init__(self, state: EngineState, clock: ClockSource, journal: RunLog, dispatcher: CommandDispatcher, monitor: RunMonitor) -> None:
        self.state = state
        self._clock, self._journal, self._dispatcher, self._monitor = clock, journal, dispatcher, monitor

    def handle(self, event: Event) -> None:
        """Log an event, pass it to the engine and execute the resulting commands."""
        self._record(event)
        if self.state.state in FINAL_STATES:
            return
        before = self.state.state
        self.state, commands = step(self.state, event)
        for command in commands:
            self._dispatcher.execute(command)
        self._update_stop_reason(before, event)

    def _record(self, event: Event) -> None:
        if isinstance(event, LoadReading | StageReading):
            self._journal.sample(event.sample)
        elif isinstance(event, _WARNING_EVENTS):
            code = FaultCode.LINK_LOST if isinstance(event, LinkLost) else event.code
            self._journal.fault(event.time_ns, event.reason, event.device.words, "passed to the engine", code)
            self._monitor.warn(f"{event.device.words}: {event.reason}")

    def _update_stop_reason(self, before: State, event: Event) -> None:
        """Store the reason of a fault for the final message; clear it when the run is resumed."""
        current, monitor = self.state.state, self._monitor
        question_open = self.state.calibration_question_open
        if (current in _FAULT_STATES and before is not current) or (question_open and before is State.CALIBRATION_GATE):
            monitor.stop_reason = progress(self.state).message
            monitor.troubled.set()
            if not isinstance(event, _WARNING_EVENTS):
                monitor.warn(monitor.stop_reason)
                if current in _FAULT_STATES:
                    code = self._dispatcher.fault_code
                    self._journal.fault(self._clock.now_ns(), monitor.stop_reason, "protocol", "stopped motion", code)
        elif not question_open and current not in (*_FAULT_STATES, *_ENDING_STATES):
            monitor.stop_reason = None
        if current is State.RESUMING is not before:
            monitor.warn(progress(self.state).message)
