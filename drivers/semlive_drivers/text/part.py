"""A device that speaks text, as a part of a load frame."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from pydantic import BaseModel, ConfigDict, Field

from semlive.data.loading import MotionState
from semlive.errors import BadConfig, LinkError, LinkRefused, SemliveError
from semlive.ports import ClockSource
from semlive_drivers.device_part import MOTIONS, PartCommand, PartReading, Stops, Way
from semlive_drivers.maps import UNCONFIRMED_NOTE
from semlive_drivers.modbus.rtu.shared_line import is_shared
from semlive_drivers.modbus.settings import SerialLine, checked
from semlive_drivers.serial_port import SerialSettings
from semlive_drivers.text.codec import NotUnderstood, fill_template, parse_reply, resolutions, step_of, with_check, without_check
from semlive_drivers.text.dialogue import Step, TextProtocol, load_dialogue
from semlive_drivers.text.line import TextLine
from semlive_drivers.text.read_back import Memory, compared, questions, values_of, without
from semlive_drivers.units import factor

_AGAIN_S = 0.02

Reply = dict[str, str | float]


class TextSettings(BaseModel):
    """Settings of a device that speaks text."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    map: str
    """Name of a description that comes with semlive, or the path of another."""
    serial: SerialLine
    timeout_s: float = Field(default=0.3, gt=0, le=5)
    """Longest wait for one answer."""
    station: int = Field(default=1, ge=0, le=999)
    """The device's number, where several share a line."""
    units: dict[str, str] = {}
    """Units that are others than the description says: `{force: kN}`."""
    confirmed: bool = False
    """Somebody has held the description beside this machine; without that nothing is moved by it."""


class TextOrders:
    """What a device can be ordered by its dialogue, as `semlive_drivers.device_part.OrderBook`.

    Args:
        dialogue: the description.
        known: the values of an order in all the ways in which a dialogue may want them.
    """

    def __init__(self, dialogue: TextProtocol, known: Callable[[PartCommand, Mapping[str, float]], Mapping[str, float]]) -> None:
        self._dialogue, self._known = dialogue, known
        self.can = frozenset(dialogue.orders)

    def order_problem(self, what: PartCommand, values: Mapping[str, float]) -> str | None:
        """Why an order cannot be given as it is meant, or None; sends nothing and never raises."""
        try:
            self.require_exact(what, self._known(what, values))
        except LinkError as error:
            return str(error)
        return None

    def require_exact(self, what: PartCommand, values: Mapping[str, float]) -> None:
        """Refuse an order whose numbers the requests do not hold as they are meant; raises LinkError."""
        for step in self._dialogue.orders.get(what, ()):
            fill_template(step.send, values)

    def step_of(self, value: str) -> float:
        """Smallest step of ``travel_mm`` or ``speed_mm_s`` in orders to pull, in that unit; 0 where a way is ordered by its end."""
        steps = self._dialogue.orders.get(PartCommand.JOG_TENSION, ())
        per_minute = value.replace("_mm_s", "_mm_min")
        return max((max(step_of(step.send, value), step_of(step.send, per_minute) / 60.0) for step in steps), default=0.0)


class TextPart:
    """The Part over a serial line of text; opened by `open_part`."""

    simulated = False
    has_watchdog = False
    manual = False

    def __init__(self, line: TextLine, dialogue: TextProtocol, settings: TextSettings) -> None:
        self._line, self.dialogue, self._settings = line, dialogue, settings
        self._units = {**dialogue.units, **settings.units}
        self._patterns = {name: re.compile(ask.reply) for name, ask in dialogue.asks.items()}
        self._values: dict[str, float] = {"station": float(settings.station)}
        self._extension_mm = 0.0
        self._steps: dict[str, float] = {}
        self._wrong_since_s: dict[str, float] = {}
        self._memory: Memory = {}
        self._differing = frozenset[str]()
        self._unreadable: set[str] = set()
        self.where = f"{line.where} station {settings.station}" if self._has_stations else line.where
        self.book = TextOrders(dialogue, lambda what, values: {**self._values, **self._derived(what, values)})
        self.stops = Stops(self._stop_blind, tuple(Way(stop.says, partial(self._stop_by, stop.steps)) for stop in dialogue.other_stops))
        for step in dialogue.identity:
            try:
                self._do(step)
            except LinkError as error:
                raise LinkRefused(f"{self.where} is another device than {dialogue.name}: {error}") from error

    @property
    def capabilities(self) -> frozenset[PartCommand]:
        """What it can be told."""
        return frozenset(self.dialogue.orders)

    def read(self) -> PartReading:
        """A fresh reading.

        Raises:
            LinkError: if nothing sensible comes back, or the device says that it is none.
        """
        return self.identify()

    def identify(self) -> PartReading:
        """A fresh reading; raises as `read`."""
        reply: Reply = {}
        for name in self.dialogue.every_turn:
            reply |= self.ask(name)
        now_s = time.monotonic()
        for rule in self.dialogue.valid:
            if int(reply[rule.group]) >> rule.bit & 1 == rule.equals:
                self._wrong_since_s.pop(rule.says, None)
            elif now_s - self._wrong_since_s.setdefault(rule.says, now_s) >= rule.for_s:
                raise LinkError(f"{self.where} gives no reading: {rule.says}")
        for group, (low, high) in self.dialogue.ranges.items():
            value = _number(reply, group)
            if value is not None and not low < value < high:
                saturated = "the sensor is saturated or not connected; check sensor, cable and amplifier"
                raise LinkError(f"{self.where}: {group} is at the end of its range ({value:g}): {saturated}")
        extension_mm = _number(reply, "extension")
        self._extension_mm = self._extension_mm if extension_mm is None else extension_mm
        return PartReading(
            force_n=_number(reply, "force"),
            extension_mm=extension_mm,
            motion=self._motion(reply),
            target_n=_number(reply, "target"),
            gage_strain=_number(reply, "gage"),
        )

    def ask(self, name: str) -> Reply:
        """The answer to one question of the dialogue.

        Raises:
            LinkError: if it does not come, or is no such answer.
        """
        ask, check = self.dialogue.asks[name], self.dialogue.check
        heard = self._line.query(self._request(ask.send), self.dialogue.ends.encode(), ask.lines)
        lines = [without_check(line, check, self.where) for line in heard]
        text = "\n".join(line.decode("ascii", errors="replace") for line in lines)
        if self.dialogue.refused and text == self.dialogue.refused:
            raise LinkError(f"{self.where} does not understand {ask.send.strip()!r}; check the description and the device's settings")
        self._steps |= resolutions(self._patterns[name], text, self._units, self.where)
        return parse_reply(self._patterns[name], text, self._units, self.where)

    def recover(self) -> None:
        """Listen until nothing late can come any more."""
        with contextlib.suppress(LinkError):
            self._line.recover()

    def command(self, what: PartCommand, values: Mapping[str, float]) -> None:
        """Give an order; returns when every step of it was taken.

        Raises:
            LinkError: if the device did not take it, or its description is not confirmed and it would move.
        """
        if what in MOTIONS and not (self.dialogue.confirmed or self._settings.confirmed):
            raise LinkError(
                f"{self.where}: the description of {self.dialogue.name} is {UNCONFIRMED_NOTE}; "
                "check it with `semlive frame check`, move the machine by its own panel and watch the values, then set confirmed: true"
            )
        known = {**self._values, **self._derived(what, values)}
        if what is not PartCommand.STOP:  # every number is checked before anything is sent
            self.book.require_exact(what, known)
        self._values = known
        # A motion replaces the order before it, and one that fails leaves values that nobody knows. After a stop the values of the last
        # motion are still compared, except those that another program or person set.
        self._memory = {} if what in MOTIONS else without(self._memory, self._differing)
        self._differing = frozenset()
        for step in self.dialogue.orders[what]:
            self._do(step)
        if what in MOTIONS:
            self._memory = values_of((*self.dialogue.orders[what], *self.dialogue.read_back.get(what, ())), known)

    def recall(self, what: PartCommand, values: Mapping[str, float]) -> None:
        """Compare the device from now on with an order of an earlier process, as `OrderHolder` does; sends nothing."""
        steps = (*self.dialogue.orders.get(what, ()), *self.dialogue.read_back.get(what, ()))
        self._memory = values_of(steps, self._derived(what, values))

    @property
    def cleared(self) -> bool:
        """False: after a restart a device that answers in text has its own settings, which need not be 0."""
        return False

    def order_changed(self) -> str | None:
        """How the device's own settings differ from the last order, as a sentence, or None; asks every question about that order.

        A question whose reply does not fit the description is not asked again.

        Raises:
            LinkError: if the device does not answer.
        """
        first: str | None = None
        for ask in questions(self._memory, self._unreadable):
            try:
                reply = self.ask(ask)
            except NotUnderstood:
                self._unreadable.add(ask)
                continue
            self._memory, found = compared(self._memory, ask, reply)
            if found is not None:
                self._differing |= {ask}
                first = first or f"{self.where}: {found}: another program or a person commands it, or it was restarted"
        return first

    def resolution(self) -> tuple[float, float]:
        """Smallest change of force, N, and of extension, mm, by the last decimal that the device tells."""
        return self._steps.get("force", 0.0), self._steps.get("extension", 0.0)

    def blind_stop(self) -> None:
        """Send a stop without waiting for an answer."""
        self.stops.blind()

    def close(self) -> None:
        """Close the line."""
        self._line.close()

    @property
    def _has_stations(self) -> bool:
        return any("{station" in ask.send for ask in self.dialogue.asks.values())

    def _stop_blind(self) -> bool:
        """Send a stop without waiting for an answer, as `semlive.ports.BlindStop`."""
        sent = False
        for step in self.dialogue.orders.get(PartCommand.STOP, ()):
            if step.send:
                with contextlib.suppress(LinkError, LinkRefused):
                    self._line.write_without_reply(self._request(step.send))
                    sent = True
        return sent

    def _stop_by(self, steps: Sequence[Step]) -> None:
        for step in steps:
            self._do(step)

    def _request(self, template: str) -> bytes:
        return with_check(fill_template(template.rstrip("\r\n"), self._values, exact=False), self.dialogue.check) + _tail(template)

    def _derived(self, what: PartCommand, values: Mapping[str, float]) -> dict[str, float]:
        """The values of an order in all the ways in which a dialogue may want them."""
        derived = dict(values)
        if "speed_mm_s" in derived:
            derived["speed_mm_min"] = derived["speed_mm_s"] * 60.0
        if "rate_n_s" in derived:
            derived["rate_n_min"] = derived["rate_n_s"] * 60.0
        if "travel_mm" in derived:
            derived["to_mm"] = self._extension_mm + (derived["travel_mm"] if what is PartCommand.JOG_TENSION else -derived["travel_mm"])
        return derived

    def _do(self, step: Step) -> None:
        if step.send:
            self._line.write(self._request(step.send))
            return
        end_s = time.monotonic() + step.within_s
        while (wrong := self._wrong(step)) and time.monotonic() < end_s:
            time.sleep(_AGAIN_S)
        if wrong:
            raise LinkError(f"{self.where} did not take the command: {wrong}; check the device's limits and who else commands it")

    def _wrong(self, step: Step) -> str:
        """What an answer says otherwise than it must, or nothing."""
        reply = self.ask(step.ask)
        for group, name in step.equals.items():
            said = _number(reply, group)
            if said is None or abs(said - self._values[name]) > step.tolerance:
                return f"{group} is {said} instead of {self._values[name]:g}"
        motion = self._motion(reply)
        return f"it says {motion} instead of {step.motion}" if step.motion is not None and motion is not step.motion else ""

    def _motion(self, reply: Reply) -> MotionState | None:
        word = reply.get("motion")
        if word is None:
            return None
        try:
            return self.dialogue.motion[str(word)]
        except KeyError:
            raise LinkError(f"{self.where} says motion {word!r}, which does not exist; check the description") from None


def _number(reply: Reply, group: str) -> float | None:
    value = reply.get(group)
    return value if isinstance(value, float) else None


def _tail(template: str) -> bytes:
    return template[len(template.rstrip("\r\n")) :].encode("ascii")


def open_part(settings: Mapping[str, object], clock: ClockSource, where: str = "ascii load frame") -> TextPart:
    """Open the line and check who answers.

    Raises:
        BadConfig: for settings or a description that are not understood.
        LinkRefused: if the line cannot be opened, or somebody else answers.
        LinkError: if the device answers nonsense.
    """
    del clock
    known = checked(TextSettings, settings, where)
    dialogue = load_dialogue(known.map)
    for unit in known.units.values():
        factor(unit, f"{where}: units")
    if is_shared(known.serial.port):
        raise BadConfig(f"{where}: {known.serial.port} is used by a Modbus device already; give each its own line")
    line = TextLine(SerialSettings.model_validate(known.serial.over(dialogue.serial)), known.timeout_s, dialogue.name)
    try:
        return TextPart(line, dialogue, known)
    except SemliveError:
        line.close()
        raise
