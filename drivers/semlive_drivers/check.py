"""`semlive frame check`: check a device without moving it; the entry point of ``semlive.frame_checks``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pydantic import BaseModel, ConfigDict

from semlive.data.checks import Finding, FrameCheck, Verdict
from semlive.errors import BadConfig
from semlive.ports import ClockSource
from semlive_drivers.device_part import OrderBook
from semlive_drivers.load_approach import ApproachSettings, ramp_problem
from semlive_drivers.maps import map_content
from semlive_drivers.modbus.check import check_modbus
from semlive_drivers.settings import checked
from semlive_drivers.text.check import check_text


class RunOrders(BaseModel):
    """Orders of a run, which are compared with those that the device can hold; nothing is sent."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    loads_n: list[float] = []
    """Target loads."""
    rate_n_s: float | None = None
    """Rate of every ramp; None checks no order."""
    approach: ApproachSettings | None = None
    """Settings for loads in displacement control."""

    def findings(self, book: OrderBook) -> Iterator[Finding]:
        """For each order, whether the device can hold it exactly."""
        for load_n in self.loads_n if self.rate_n_s is not None else ():
            rate_n_s = self.rate_n_s or 0.0
            problem = ramp_problem(book, self.approach, load_n, rate_n_s)
            what = f"{load_n:g} N at {rate_n_s:g} N/s"
            if problem is None:
                yield Finding(what, "can be ordered exactly", Verdict.OK)
            else:
                yield Finding(what, problem, Verdict.FAILED, "correct the load, the rate or the description")


def check_frame(name: str, settings: Mapping[str, object], clock: ClockSource) -> FrameCheck:
    """Check a device against its description.

    Args:
        name: name of the description, or a path.
        settings: as of the driver, with the orders of a run under ``orders`` (`RunOrders`).
        clock: experiment time.

    Raises:
        BadConfig: for settings or a description that are not valid.
        LinkRefused: if no device answers.
        LinkError: if the link is lost during the check.
    """
    orders = settings.get("orders", {})
    run_orders = checked(RunOrders, orders if isinstance(orders, Mapping) else {"orders": orders}, "frame check: orders")
    rest = {key: value for key, value in settings.items() if key != "orders"}
    if map_content(name)["protocol"] == "modbus":
        return check_modbus(name, rest, run_orders.findings)
    if "serial" not in settings:
        raise BadConfig(f"{name} is connected by a serial line; give its path: --port /dev/ttyUSB0")
    return check_text(name, {key: value for key, value in rest.items() if key != "unit"}, clock, run_orders.findings)
