"""Checks between the opening of the devices and the first order: nothing is sent to a device."""

from __future__ import annotations

from collections.abc import Mapping

from semlive.data.experiment import Plan
from semlive.data.loading import DeviceIdentity
from semlive.engine import Device
from semlive.errors import BadConfig
from semlive.service.device_link import DeviceLink


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
