"""A device that is controlled by text, as a part of a load frame."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial

from pydantic import BaseModel, ConfigDict, Field

from semlive.errors import BadConfig, LinkError, LinkRefused, SemliveError
from semlive.ports import ClockSource
from semlive_drivers.device_part import FOREIGN_ORDER, MOTIONS, SATURATED, PartCommand, PartReading, StopMethod, Stops
from semlive_drivers.maps import require_confirmed
from semlive_drivers.modbus.rtu.shared_line import is_shared
from semlive_drivers.serial_port import SerialSettings
from semlive_drivers.settings import SerialLine, checked
from semlive_drivers.text.codec import NotUnderstood
from semlive_drivers.text.dialogue import Step, TextProtocol, load_dialogue
from semlive_drivers.text.line import TextLine
from semlive_drivers.text.orders import TextOrders, order_values
from semlive_drivers.text.read_back import Memory, compared, questions, values_of, without
from semlive_drivers.text.session import DialogueSession, Reply, number
from semlive_drivers.units import factor


class TextSettings(BaseModel):
    """Settings of a device that is controlled by text."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    map: str
    """Name of a description that comes with semlive, or the path of another."""
    serial: SerialLine
    timeout_s: float = Field(default=0.3, gt=0, le=5)
    """Longest wait for one answer."""
    station: int = Field(default=1, ge=0, le=999)
    """Number of the device where several devices share a line."""
    units: dict[str, str] = {}
    """Units that differ from the description: `{force: kN}`."""
    confirmed: bool = False
    """True if the description was compared with this machine; otherwise no motion is ordered."""


class TextPart:
    """The DevicePart over a serial line of text; opened by `open_part`.

    Args:
        line: open.
        dialogue: the description of the device.
        settings: of the part.

    Raises:
        LinkRefused: if another device answers.
    """

    simulated = False
    has_watchdog = False
    manual = False

    def __init__(self, line: TextLine, dialogue: TextProtocol, settings: TextSettings) -> None:
        self.dialogue, self._settings = dialogue, settings
        self.session = DialogueSession(line, dialogue, settings.units, settings.station)
        self.where = self.session.where
        self._extension_mm = 0.0
        self._wrong_since_s: dict[str, float] = {}
        self._memory: Memory = {}
        self._differing = frozenset[str]()
        self._unreadable: set[str] = set()
        self.book = TextOrders(dialogue, self._all_values)
        self.capabilities = self.book.can
        other_stops = tuple(StopMethod(stop.says, partial(self._stop_by, stop.steps)) for stop in dialogue.other_stops)
        self.stops = Stops(lambda: self.session.send_blind(dialogue.orders.get(PartCommand.STOP, ())), other_stops)
        for step in dialogue.identity:
            try:
                self.session.perform(step)
            except LinkError as error:
                raise LinkRefused(f"{self.where} is another device than {dialogue.name}: {error}") from error

    def read(self) -> PartReading:
        """Take a new reading.

        Raises:
            LinkError: if no valid answer comes, or a rule of the dialogue states that the reading is invalid.
        """
        return self.identify()

    def identify(self) -> PartReading:
        """Take a new reading; raises as `read`."""
        reply: Reply = {}
        for name in self.dialogue.every_turn:
            reply |= self.session.ask(name)
        now_s = time.monotonic()
        for rule in self.dialogue.valid:
            if int(reply[rule.group]) >> rule.bit & 1 == rule.equals:
                self._wrong_since_s.pop(rule.says, None)
            elif now_s - self._wrong_since_s.setdefault(rule.says, now_s) >= rule.for_s:
                raise LinkError(f"{self.where} gives no reading: {rule.says}")
        for group, (low, high) in self.dialogue.ranges.items():
            value = number(reply, group)
            if value is not None and not low < value < high:
                raise LinkError(f"{self.where}: {group} is at the end of its range ({value:g}): {SATURATED}")
        extension_mm = number(reply, "extension")
        self._extension_mm = self._extension_mm if extension_mm is None else extension_mm
        return PartReading(
            force_n=number(reply, "force"),
            extension_mm=extension_mm,
            motion=self.session.motion(reply),
            target_n=number(reply, "target"),
            gage_strain=number(reply, "gage"),
        )

    def command(self, order: PartCommand, values: Mapping[str, float]) -> None:
        """Give an order; returns after every step of it succeeded.

        Raises:
            LinkError: if the device did not take it, or if it is a motion and the description is not confirmed.
        """
        if order in MOTIONS:
            require_confirmed(self.where, self.dialogue.name, confirmed=self.dialogue.confirmed or self._settings.confirmed)
        all_values = dict(self._all_values(order, values))
        if order is not PartCommand.STOP:  # every number is checked before anything is sent
            self.book.require_exact(order, all_values)
        self.session.values = all_values
        # A motion replaces the order before it, and after a failed motion the values in the device are unknown. After a stop the values
        # of the last motion are still compared, except those that another program or a person set.
        self._memory = {} if order in MOTIONS else without(self._memory, self._differing)
        self._differing = frozenset()
        for step in self.dialogue.orders[order]:
            self.session.perform(step)
        if order in MOTIONS:
            self._memory = values_of((*self.dialogue.orders[order], *self.dialogue.read_back.get(order, ())), all_values)

    def recall(self, order: PartCommand, values: Mapping[str, float]) -> None:
        """Compare the device from now on with an order of an earlier process, as `OrderHolder` does; sends nothing."""
        steps = (*self.dialogue.orders.get(order, ()), *self.dialogue.read_back.get(order, ()))
        self._memory = values_of(steps, order_values(order, values, self._extension_mm))

    @property
    def cleared(self) -> bool:
        """False: after a restart a device that answers in text has its own settings, which need not be 0."""
        return False

    def order_changed(self) -> str | None:
        """How the settings of the device differ from the last order, as a message, or None; asks every question about that order.

        A question whose reply does not fit the description is not asked again.

        Raises:
            LinkError: if the device does not answer.
        """
        first: str | None = None
        for ask in questions(self._memory, self._unreadable):
            try:
                reply = self.session.ask(ask)
            except NotUnderstood:
                self._unreadable.add(ask)
                continue
            self._memory, difference = compared(self._memory, ask, reply)
            if difference is not None:
                self._differing |= {ask}
                first = first or f"{self.where}: {difference}: {FOREIGN_ORDER}"
        return first

    def resolution(self) -> tuple[float, float]:
        """Smallest change of force, N, and of extension, mm, by the last decimal in the replies of the device."""
        return self.session.resolutions.get("force", 0.0), self.session.resolutions.get("extension", 0.0)

    def blind_stop(self) -> None:
        """Send a stop without waiting for an answer."""
        self.stops.blind()

    def close(self) -> None:
        """Close the line."""
        self.session.close()

    def _all_values(self, order: PartCommand, values: Mapping[str, float]) -> Mapping[str, float]:
        return {**self.session.values, **order_values(order, values, self._extension_mm)}

    def _stop_by(self, steps: Sequence[Step]) -> None:
        for step in steps:
            self.session.perform(step)


def open_part(settings: Mapping[str, object], clock: ClockSource, where: str = "ascii load frame") -> TextPart:
    """Open the line and check the identity of the device.

    Args:
        settings: as of `TextSettings`.
        clock: experiment time; not used.
        where: name of the settings in an error.

    Raises:
        BadConfig: for settings or a description that are not valid.
        LinkRefused: if the line cannot be opened, or another device answers.
        LinkError: if an answer is not valid.
    """
    del clock
    config = checked(TextSettings, settings, where)
    dialogue = load_dialogue(config.map)
    for unit in config.units.values():
        factor(unit, f"{where}: units")
    if is_shared(config.serial.port):
        raise BadConfig(f"{where}: {config.serial.port} is used by a Modbus device already; give each its own line")
    line = TextLine(SerialSettings.model_validate(config.serial.over(dialogue.serial)), config.timeout_s, dialogue.name)
    try:
        return TextPart(line, dialogue, config)
    except SemliveError:
        line.close()
        raise
