"""Devices of a run: links and trigger from the configuration, opening, checks before the first order, and closing.

Theory of operation
-------------------
`open_links` opens all links at once in worker threads, and the loop keeps them alive meanwhile. `close_links` blocks until each device is
at rest or its time is over; the daemon calls it in a worker thread. Nothing is ordered here.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from semlive.data.experiment import Plan
from semlive.data.loading import DeviceIdentity
from semlive.engine import Device, Event
from semlive.errors import BadConfig
from semlive.service.config.configuration import Config
from semlive.service.control.control import Control
from semlive.service.control.previous_segments import PreviousSegments
from semlive.service.device_link import DeviceLink
from semlive.service.device_link.trigger import TriggerLink
from semlive.service.runtime import drivers
from semlive.service.runtime.clock import SimulatedClock, SystemClock

TICK_S = 0.05
"""Interval between the ticks of the loop, and between keep-alive signals to the links, s."""
_OPEN_TIMEOUT_S = 10.0


def device_links(
    config: Config, control: Control, clock: SystemClock | SimulatedClock, previous: PreviousSegments | None
) -> dict[Device, DeviceLink]:
    """Return a link, which is not open, for each configured device; its events go to the engine."""
    frame, stage, limits = config.load_frame, config.stage, config.plan().limits

    def on_event(event: Event) -> None:
        control.call_soon(control.engine.handle, event)

    links = dict[Device, DeviceLink]()
    if frame is not None:
        links[Device.LOAD_FRAME] = DeviceLink(
            Device.LOAD_FRAME,
            lambda: drivers.open_load_frame(frame.driver, frame.settings, clock),
            on_event,
            clock=clock,
            limits=limits,
            poll_s=frame.poll_s,
            recalled=None if previous is None else previous.interrupted_run.ordered,
        )
    if stage is not None:
        links[Device.STAGE] = DeviceLink(
            Device.STAGE,
            lambda: drivers.open_stage(stage.driver, stage.settings, clock),
            on_event,
            clock=clock,
            limits=limits,
            poll_s=stage.poll_s,
        )
    return links


def open_trigger(config: Config, control: Control, clock: SystemClock | SimulatedClock) -> TriggerLink | None:
    """Open the configured trigger; None without one."""
    trigger = config.sem.trigger
    if trigger is None:
        return None
    opened = drivers.open_trigger(trigger.driver, trigger.settings, clock)
    return TriggerLink(
        opened,
        lambda event: control.call_soon(control.engine.handle, event),
        clock,
        lambda report: control.call_soon(control.dispatcher.log_scan, report),
    )


async def open_links(links: Mapping[Device, DeviceLink]) -> Mapping[Device, DeviceIdentity]:
    """Open all links concurrently; open links receive keep-alive signals meanwhile.

    Raises:
        SemliveError: a device does not answer, or another device answers.
    """
    loop = asyncio.get_running_loop()
    opening = asyncio.gather(*(loop.run_in_executor(None, link.open, _OPEN_TIMEOUT_S) for link in links.values()))
    while not opening.done():
        for link in links.values():
            link.keep_alive()
        await asyncio.sleep(TICK_S)
    return dict(zip(links, opening.result(), strict=True))


def close_links(links: Mapping[Device, DeviceLink]) -> list[str]:
    """Stop all devices at once, then wait for each; return a message for each device without a confirmed stop."""
    for link in links.values():
        link.stop("the run is over")
    unconfirmed = [device for device, link in links.items() if not link.close()]
    return [
        f"the {device.words} did not confirm that it stopped: look at the machine, and press its emergency stop if it moves"
        for device in unconfirmed
    ]


def require_attendance(identities: Mapping[Device, DeviceIdentity], attended: bool) -> None:
    """Reject an unattended run with a real machine.

    Raises:
        BadConfig: a device is no simulator, and `attended` is False.
    """
    for device, identity in identities.items():
        if not identity.simulated and not attended:
            raise BadConfig(
                f"{device.words} {identity.name}: is a real machine, and unattended runs are not released yet; "
                f"give --attended and stay at the instrument"
            )


def require_orders(link: DeviceLink | None, plan: Plan) -> None:
    """Reject a plan with a load that the device would receive wrongly: rounded to zero, or clipped by a scale.

    Args:
        link: open link of the load frame; None without a load frame.
        plan: plan of the run.

    Raises:
        BadConfig: a load cannot be ordered.
    """
    ramps = [(step.load_n, plan.ramp_rate_n_s) for step in plan.steps if step.load_n is not None]
    problem = None if link is None else link.order_problem(ramps)
    if problem is not None:
        raise BadConfig(f"load_frame: {problem}; correct the plan, or the scale in the device's description")
