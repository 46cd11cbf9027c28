"""`semlive frame check`: looks at a device without moving it; the entry point of ``semlive.frame_checks``."""

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
from semlive_drivers.modbus.settings import checked
from semlive_drivers.text.check import check_text


class WantedOrders(BaseModel):
    """Orders that a run will give, to be held against what the device can hold; nothing is sent."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    loads_n: list[float] = []
    """Loads to go to."""
    rate_n_s: float | None = None
    """Rate of every ramp; without one, no order is looked at."""
    approach: ApproachSettings | None = None
    """How a load is approached in displacement control."""

    def findings(self, book: OrderBook) -> Iterator[Finding]:
        """Each order, whether the device can hold it as it is meant."""
        for load_n in self.loads_n if self.rate_n_s is not None else ():
            rate_n_s = self.rate_n_s or 0.0
            problem = ramp_problem(book, self.approach, load_n, rate_n_s)
            what = f"{load_n:g} N at {rate_n_s:g} N/s"
            if problem is None:
                yield Finding(what, "can be ordered as meant", Verdict.OK)
            else:
                yield Finding(what, problem, Verdict.FAILED, "correct the load, the rate or the description")


def check_frame(name: str, settings: Mapping[str, object], clock: ClockSource) -> FrameCheck:
    """Look at the device that a description describes.

    Args:
        name: of the description, or a path.
        settings: as of the driver, and under ``orders`` the orders of a run (`WantedOrders`).
        clock: experiment time.

    Raises:
        BadConfig: for settings or a description that are not understood.
        LinkRefused: if nobody answers.
        LinkError: if the link is lost meanwhile.
    """
    given = settings.get("orders", {})
    wanted = checked(WantedOrders, given if isinstance(given, Mapping) else {"orders": given}, "frame check: orders")
    rest = {key: value for key, value in settings.items() if key != "orders"}
    if map_content(name)["protocol"] == "modbus":
        return check_modbus(name, rest, wanted.findings)
    if "serial" not in settings:
        raise BadConfig(f"{name} speaks over a serial line; give its path: --port /dev/ttyUSB0")
    return check_text(name, {key: value for key, value in rest.items() if key != "unit"}, clock, wanted.findings)
