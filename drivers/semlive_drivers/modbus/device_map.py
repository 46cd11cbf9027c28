"""A device that speaks Modbus, described as data : its points, their meaning and its commands (docs/reference/register-maps.md)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from semlive.data.loading import DeviceFault, MotionState
from semlive_drivers.device_part import PartCommand
from semlive_drivers.maps import validate_map
from semlive_drivers.modbus.registers import MAX_BLOCK, BitField, DType, Factor, Kind, RegisterPoint, WordOrder
from semlive_drivers.units import factor

ORDERED = ("force_n", "rate_n_s", "travel_mm", "speed_mm_s", "watchdog_s", "nonce")
"""What an order may write besides numbers; a minus sign in front turns it."""


class _Described(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def _unit(name: str) -> str:
    factor(name, "unit")
    return name


Unit = Annotated[str, AfterValidator(_unit)]


class PointConfig(_Described):
    """A point as it is written in a description; see `RegisterPoint`."""

    kind: Kind
    address: int
    dtype: DType = DType.U16
    words: WordOrder = WordOrder.HIGH_FIRST
    byte_order: WordOrder = WordOrder.HIGH_FIRST
    scale: float = 1.0
    offset: float = 0.0
    bits: tuple[int, int] | None = None
    """Lowest bit and number of bits."""
    sentinels: tuple[int, ...] = ()
    sign: tuple[str, int] | None = None
    """Point and bit that is set when the number is negative."""
    decimals: tuple[str, int, int] | None = None
    """Point, lowest bit and number of bits that hold the number of decimals."""
    factors: list[FactorConfig] = []
    range: tuple[float, float] | None = None
    """Values at or beyond which a reading is none, in the unit of the value: the ends of the sensor."""

    @model_validator(mode="after")
    def _range_rises(self) -> PointConfig:
        if self.range is not None and not self.range[0] < self.range[1]:
            raise ValueError(f"range {list(self.range)} must give the low end first")
        return self

    def point(self) -> RegisterPoint:
        """The value of it."""
        factors = tuple(Factor(BitField(text.point, *text.bits), tuple(text.values.items())) for text in self.factors)
        if self.decimals is not None:
            factors = (*factors, Factor(BitField(*self.decimals)))
        return RegisterPoint(
            self.kind,
            self.address,
            self.dtype,
            self.words,
            self.scale,
            self.byte_order,
            self.offset,
            *(self.bits or (0, 0)),
            self.sentinels,
            None if self.sign is None else BitField(self.sign[0], self.sign[1], 1),
            factors,
            self.range,
        )


class FactorConfig(_Described):
    """A table of what a number in another point's word means for the size of this one."""

    point: str
    bits: tuple[int, int] = (0, 16)
    values: dict[int, float]


def _as_list(given: object) -> object:
    return [given] if isinstance(given, int) else given


class Condition(_Described):
    """Something that can be true of a point."""

    point: str
    bit: int | None = Field(default=None, ge=0, le=63)
    """Of its word; without it, the whole number."""
    equals: Annotated[list[int], BeforeValidator(_as_list)] = [1]
    says: str = ""
    """For a person, where it is not as it must be."""

    def holds(self, word: int) -> bool:
        """Whether it is true of the point's number."""
        return (word if self.bit is None else word >> self.bit & 1) in self.equals


class Motion(_Described):
    """How the device tells whether it moves: words of one point, or conditions of which any one is enough."""

    point: str | None = None
    states: dict[int, MotionState] = {}
    moving: list[Condition] = []
    fault: list[Condition] = []

    @property
    def points(self) -> set[str]:
        """The points that it needs."""
        return {condition.point for condition in (*self.moving, *self.fault)} | ({self.point} if self.point else set())


class FaultReason(_Described):
    """Where the device tells why it is in fault, and in which words."""

    point: str
    words: dict[int, DeviceFault]


class Readouts(_Described):
    """Which point says what; ``unit`` is that of the point's value."""

    force: str | None = None
    force_unit: Unit = "N"
    extension: str | None = None
    extension_unit: Unit = "mm"
    target: str | None = None
    force_limit: str | None = None
    lag: str | None = None
    counter: str | None = None
    """Counts readings: one that stands still means a frozen reading."""
    strain_gage: str | None = None
    strain_gage_unit: Unit = "1"
    motion: Motion | None = None
    trouble: FaultReason | None = None
    """Asked for only while the device is in fault."""


class Write(_Described):
    """One request of an order."""

    set: dict[str, float | str] = Field(min_length=1)
    """By point, a number or one of `ORDERED`; the points are written in one request."""
    verify: bool = False
    """Read back, and refuse to go on if it is not the same."""
    single: bool = False
    """FC06 or FC05 in place of FC16 or FC15."""


class OtherStop(_Described):
    """A further way to stop the device, tried when it does not obey its stop order."""

    says: str = Field(min_length=1)
    """What it does, for a person: ``enable off``, ``speed 0``."""
    writes: list[Write] = Field(min_length=1)


class Heartbeat(_Described):
    """What is written with every reading to feed the device's watchdog."""

    point: str
    how: Literal["constant", "toggle", "counter"] = "counter"
    value: int = 1
    """What is written again and again, or the highest number before the counter begins anew at 0 (0: 65,535)."""


class SerialConfig(_Described):
    """How the device's line is set as it leaves the factory; the configuration says how it is here."""

    baud: int = 19_200
    parity: Literal["none", "even", "odd"] = "even"
    stop_bits: Literal[1, 2] = 1
    silence_s: float = 0.0
    slowest_s: float = 1.0


class DeviceMap(_Described):
    """A whole description."""

    protocol: Literal["modbus"]
    name: str
    source: str
    """Where the registers are from, and whether anybody held them beside the machine."""
    confirmed: bool = False
    """True only where the device itself was seen to move as described; otherwise motion asks for `confirmed: true` in the configuration."""
    notes: str = ""
    serial: SerialConfig = SerialConfig()
    max_block: int = Field(default=MAX_BLOCK, ge=1, le=MAX_BLOCK)
    points: dict[str, PointConfig]
    every_turn: list[list[str]] = []
    """Groups of points, each read in one request with every reading."""
    identity: list[Condition] = []
    """What must be true of whoever answers; the first may be another in the configuration."""
    plausible: dict[str, tuple[float, float]] = {}
    """Values between which a point's value lies at rest, for `semlive frame check`."""
    simulated: Condition | None = None
    stops_by_itself: Condition | None = None
    """True of a device that stops when its watchdog expires, once it is armed."""
    tells: Readouts = Readouts()
    valid: list[Condition] = []
    """What must be true of every reading; otherwise it is none."""
    orders: dict[PartCommand, list[Write]] = {}
    other_stops: list[OtherStop] = []
    """Further ways to stop, in the order in which they are tried; only what the device's documents state."""
    changes_by_itself: list[str] = []
    """Points that orders write and the device changes on its own afterwards; they are not compared with what was written."""
    heartbeat: Heartbeat | None = None

    @model_validator(mode="after")
    def _points_exist(self) -> DeviceMap:
        for where, names in self._named().items():
            for name in names:
                if name not in self.points:
                    raise ValueError(f"{where} names a point {name!r} that is not among points")
        every = {name for group in self.every_turn for name in group}
        told = {*self._told(), *(condition.point for condition in self.valid)}
        for name in list(told):
            told |= set(self.points[name].point().needs)
        if told - every:
            raise ValueError(f"every_turn must hold {', '.join(sorted(told - every))}, which is told or needed with every reading")
        for what, writes in self.orders.items():
            for write in writes:
                self._check_write(f"orders.{what}", write)
        for stop in self.other_stops:
            for write in stop.writes:
                self._check_write(f"other_stops ({stop.says})", write)
        return self

    def _check_write(self, where: str, write: Write) -> None:
        """Refuse what an order cannot write exactly."""
        for name, value in write.set.items():
            if isinstance(value, str) and value.removeprefix("-") not in ORDERED:
                raise ValueError(f"{where} writes {value!r}; an order can write numbers and {', '.join(ORDERED)}")
            text = self.points[name]
            if text.kind in (Kind.INPUT, Kind.DISCRETE):
                raise ValueError(f"{where} writes {name}, which is read-only ({text.kind}); write holding registers or coils")
            if text.bits or text.sign or text.factors or text.decimals:
                raise ValueError(f"{where} writes {name}, whose value depends on other bits or registers; write a plain number")

    def _told(self) -> set[str]:
        tells = self.tells
        named = {tells.force, tells.extension, tells.target, tells.force_limit, tells.lag, tells.counter} - {None}
        return {name for name in named if name} | (tells.motion.points if tells.motion else set())

    def _asked_apart(self) -> set[str]:
        tells = self.tells
        return ({tells.strain_gage} if tells.strain_gage else set()) | ({tells.trouble.point} if tells.trouble else set())

    def _named(self) -> dict[str, set[str]]:
        needs = {name for text in self.points.values() for name in text.point().needs}
        conditions = [*self.identity, *self.valid, *(c for c in (self.simulated, self.stops_by_itself) if c)]
        return {
            "points": needs,
            "tells": self._told() | self._asked_apart(),
            "every_turn": {name for group in self.every_turn for name in group},
            "identity or valid": {condition.point for condition in conditions},
            "plausible": set(self.plausible),
            "orders": {name for writes in self.orders.values() for write in writes for name in write.set},
            "other_stops": {name for stop in self.other_stops for write in stop.writes for name in write.set},
            "changes_by_itself": set(self.changes_by_itself),
            "heartbeat": {self.heartbeat.point} if self.heartbeat else set(),
        }


def load_map(name: str) -> DeviceMap:
    """A description by name or path.

    Raises:
        BadConfig: if there is none, or something in it is wrong.
    """
    return validate_map(DeviceMap, name)


def number(value: Any, values: dict[str, float]) -> float:
    """What an order writes: a number, or one of the values of the order."""
    if not isinstance(value, str):
        return float(value)
    return -values[value[1:]] if value.startswith("-") else values[value]
