"""The machine of the second load frame: specimen, servo, cell and the faults of each. Standard library only; times are monotonic s."""

from __future__ import annotations

import math
import random
import time
from collections import deque

from second_settings import FAULT, MOVING, STILL, Character, Shown, Switches


class Machine:
    """Specimen, drive, servo and cell; `force_n` and `extension_mm` are true."""

    def __init__(self, character: Character, switches: Switches) -> None:
        self.character, self.switches = character, switches
        self._chance = random.Random(int(character.seed))
        self._now_s = self._born_s = time.monotonic()
        self.extension_mm = self.force_n = self.target_n = self.rate_n_s = self.relaxed_n = 0.0
        self.moving, self.powered = False, True
        self._setpoint_n = self._speed_mm_s = self._travel_left_mm = self._travel_speed_mm_s = 0.0
        self._mode, self._starts_s, self._in_reach_s = "rest", 0.0, 0.0
        self._stop_at_s: float | None = None
        self._count, self._filtered_n, self._offset_n = 0.0, 0.0, 0.0
        self._frozen_n: float | None = None
        self._frozen_mm: float | None = None
        self._since: dict[str, float] = {}
        self._history: deque[tuple[float, float]] = deque(maxlen=5000)
        self._value: tuple[float, float] = (0.0, 0.0)

    # ---- orders

    def ramp(self, target_n: float, rate_n_s: float) -> float:
        """Go to a load; gives the target that it takes."""
        if self.switches.roundtarget:
            target_n = round(target_n / self.switches.roundtarget) * self.switches.roundtarget
        self.target_n, self.rate_n_s = target_n, rate_n_s
        if self._mode != "ramp":
            self._setpoint_n, self._starts_s = self._sensed(), self._now_s + self.character.start_s
        self._begin("ramp")
        return target_n

    def travel(self, travel_mm: float, speed_mm_s: float) -> None:
        """Go a way."""
        if self._mode != "travel":
            self._starts_s = self._now_s + self.character.start_s
        self._travel_left_mm, self._travel_speed_mm_s = travel_mm, speed_mm_s
        self._begin("travel")

    def _begin(self, mode: str) -> None:
        self._mode, self.moving, self._in_reach_s, self._stop_at_s = mode, self.powered, 0.0, None

    def change_target(self, target_n: float) -> None:
        """Another program or a person gives another target."""
        self.target_n, self.rate_n_s = target_n, self.rate_n_s or 20.0
        if self._mode != "ramp":
            self._setpoint_n = self._sensed()
        self._begin("ramp")

    def stop(self) -> bool:
        """A stop order; whether it is taken."""
        if self.switches.enable or self.switches.ignorestop > 0:
            self.switches.ignorestop = max(0, self.switches.ignorestop - 1)
            return False
        self._stop_at_s = self._stop_at_s or self._now_s + self.switches.stopdelay
        if self.switches.stopdelay == 0 and self.switches.coast == 0:
            self._rest()
        return True

    def drive_off(self) -> bool:
        """The drive is switched off, which always stops it; whether it moved."""
        moved, _ = self.moving, self._rest()
        return moved

    def _rest(self) -> None:
        self._mode, self.moving, self._stop_at_s, self._speed_mm_s = "rest", False, None, 0.0

    def reboot(self) -> None:
        """Power off and on: motion ends, orders and counter are forgotten."""
        self._rest()
        self.target_n = self.rate_n_s = self._count = 0.0

    def command(self, name: str, value: float) -> None:
        """Set a switch, or ``F``, ``press`` (its own stop button), ``break`` (the specimen breaks), ``slip`` (N that are lost)."""
        self._since[name] = time.monotonic()
        if name == "F":
            self.extension_mm = self._inverse(value)
            self._load()
        elif name == "press":
            self._rest()
        elif name == "break":
            self.relaxed_n, self.character.stiffness_n_mm = 0.0, 1e-6
        elif name == "slip":
            self.relaxed_n += value
        elif name == "goto":
            self.change_target(value)
        elif hasattr(self.switches, name):
            kind = int if name in ("spike", "ignorestop", "busy", "excw") else float
            setattr(self.switches, name, kind(value))
        else:
            raise ValueError(f"{name} is no switch of the second frame")

    # ---- time

    def advance(self) -> str | None:
        """Let the time pass that has passed; gives what is to be noted."""
        now_s = time.monotonic()
        passed_s, self._now_s = min(now_s - self._now_s, 0.1), now_s
        noted, count = None, max(1, math.ceil(passed_s / 0.004))
        for _ in range(count):
            noted = self._step(passed_s / count) or noted
        self._history.append((now_s, self.force_n))
        self._count += passed_s * 100 * (-1 if self.switches.countback else 0 if self.switches.countstop else 1)
        share = 1.0 if self.character.lag_s == 0 else min(1.0, passed_s / self.character.lag_s)
        self._filtered_n += share * (self.force_n - self._filtered_n)
        return noted

    def _step(self, dt: float) -> str | None:
        noted = None
        if self.switches.trip and self.moving:
            self._rest()
            noted = "TRIPPED"
        if self._stop_at_s is not None and self._now_s >= self._stop_at_s + self.switches.coast:
            self._rest()
            noted = "RESTS"
        if self.moving and self._now_s >= self._starts_s and not self.switches.jam:
            noted = (self._ramped(dt) if self._mode == "ramp" else self._travelled(dt)) or noted
        elif not self.moving:
            self._at_rest(dt)
        self._load()
        return noted

    def _ramped(self, dt: float) -> str | None:
        item, rate = self.character, self.rate_n_s * (self.switches.ratex or 1.0)
        target = self.switches.hiddentarget or self.target_n * (self.switches.targetx or 1.0)
        gap = target - self._setpoint_n
        arrived = abs(gap) <= rate * dt and not self.switches.runaway
        slope = 0.0 if arrived else math.copysign(rate, 1.0 if self.switches.runaway else gap)
        self._setpoint_n = target if arrived else self._setpoint_n + slope * dt
        force_n, stiffness = self._sensed(), max(self._stiffness(), 1.0)
        way = -1.0 if self.switches.wrongway else 1.0
        pull = item.servo_rad_s**2 * (self._setpoint_n - force_n) / stiffness
        self._speed_mm_s += dt * (way * pull - 2.0 * item.damping * item.servo_rad_s * (self._speed_mm_s - way * slope / stiffness))
        fastest = item.speed_mm_s * (self.switches.ratex or 1.0)
        self._speed_mm_s = min(max(self._speed_mm_s, -fastest), fastest)
        slowed = 1.0
        if self._stop_at_s is not None and self.switches.coast:
            slowed = max(0.0, 1.0 - max(0.0, self._now_s - self._stop_at_s) / self.switches.coast)
        self.extension_mm += self._speed_mm_s * dt * slowed
        in_reach = arrived and abs(force_n - target) < 0.4
        self._in_reach_s = self._in_reach_s + dt if in_reach else 0.0
        if self._in_reach_s < 0.15:
            return None
        self._rest()
        return "ARRIVED"

    def _travelled(self, dt: float) -> str | None:
        speed = self._travel_speed_mm_s * (self.switches.ratex or 1.0)
        way = min(abs(self._travel_left_mm), speed * dt)
        sign = math.copysign(1.0, self._travel_left_mm) * (-1.0 if self.switches.wrongway else 1.0)
        self._travel_left_mm -= math.copysign(0.0 if self.switches.runaway else way, self._travel_left_mm)
        self.extension_mm += sign * way
        if abs(self._travel_left_mm) < 1e-12:
            self._rest()
        return None

    def _at_rest(self, dt: float) -> None:
        item, stiffness = self.character, max(self._stiffness(), 1.0)
        bound = item.relax * (self.force_n + self.relaxed_n)
        if item.relax and self.relaxed_n < bound:
            self.relaxed_n += dt / item.relax_s * (bound - self.relaxed_n)
            if item.hold_force:
                self.extension_mm += dt / item.relax_s * (bound - self.relaxed_n) / stiffness
        self.extension_mm += dt * self.switches.creep / stiffness
        if item.hunt_n and self.force_n > 20.0:
            turn = 2.0 * math.pi * item.hunt_hz
            self.extension_mm += dt * turn * item.hunt_n * math.cos(turn * self._now_s) / stiffness

    # ---- the specimen

    def _stiffness(self) -> float:
        return self.character.stiffness_n_mm * (self.character.toe_part if self.force_n < self.character.toe_n else 1.0)

    def _load(self) -> None:
        item = self.character
        way, soft = max(0.0, self.extension_mm - item.slack_mm), item.stiffness_n_mm * item.toe_part
        bend = item.toe_n / soft if item.toe_n else 0.0
        elastic = soft * min(way, bend) + item.stiffness_n_mm * max(0.0, way - bend)
        if self.extension_mm < 0.0:
            elastic = item.stiffness_n_mm * self.extension_mm
        self.force_n = elastic - self.relaxed_n if elastic > 0.0 else elastic

    def _inverse(self, force_n: float) -> float:
        item = self.character
        soft = item.stiffness_n_mm * item.toe_part
        bend = min(force_n, item.toe_n)
        return item.slack_mm + bend / soft + (force_n - bend) / item.stiffness_n_mm

    # ---- the cell

    def _sensed(self) -> float:
        """What the servo acts on."""
        return self._spoilt(self.force_n) if self.character.sensed else self.force_n

    def _part(self, name: str, within_s: float) -> float:
        return min(1.0, (time.monotonic() - self._since.get(name, self._born_s)) / within_s)

    def _spoilt(self, force_n: float) -> float:
        """The reading without noise."""
        s = self.switches
        if s.late:
            then_s = time.monotonic() - s.late
            force_n = next((value for at_s, value in reversed(self._history) if at_s <= then_s), 0.0)
        frozen = s.freeze or s.noisyfreeze or (s.freezeat and self.force_n >= s.freezeat)
        if not frozen:
            self._frozen_n = None
        elif self._frozen_n is None:
            self._frozen_n = force_n
        force_n = force_n if self._frozen_n is None else self._frozen_n
        force_n = min(force_n, s.clip) if s.clip else force_n
        force_n *= s.gain or 1.0
        force_n *= 1.0 - 2.0 * self._part("flip", s.flip) if s.flip else 1.0
        force_n *= 1.0 - self._part("fade", s.fade) if s.fade else 1.0
        return force_n + s.jump

    def shown(self) -> Shown:
        """Present values of the registers."""
        s, item, now_s = self.switches, self.character, time.monotonic()
        if now_s >= self._value[0] + item.cell_s:
            force_n = self._spoilt(self._filtered_n) + item.drift_n_s * (now_s - self._born_s)
            if not (s.freeze or (s.freezeat and self._frozen_n is not None)):
                force_n += self._chance.gauss(0.0, item.noise_n)
            force_n = round(force_n / item.lsb_n) * item.lsb_n if item.lsb_n else force_n
            self._value = (now_s, math.floor(force_n / s.sticky) * s.sticky if s.sticky else force_n)
        force_n = self._value[1]
        if s.spike > 0:
            s.spike -= 1
            force_n = 10_000.0
        force_n = math.nan if s.nan else math.inf if s.inf else -9999.0 if s.lost else force_n
        return Shown(self._state(), force_n, self._extension(), self.target_n, int(self._count) % 2**32)

    def _extension(self) -> float:
        s, item = self.switches, self.character
        self._frozen_mm = None if not s.efreeze else self.extension_mm if self._frozen_mm is None else self._frozen_mm
        value = self.extension_mm if self._frozen_mm is None else self._frozen_mm
        value += self._chance.gauss(0.0, item.extension_noise_mm) if self._frozen_mm is None else 0.0
        return round(value / item.extension_lsb_mm) * item.extension_lsb_mm + s.ejump

    def _state(self) -> int:
        s = self.switches
        if s.trip:
            return FAULT
        return MOVING if s.stuckmoving else STILL if s.stuckstill else int(self.moving)

    def reply_latency_s(self, link: int = 0) -> float:
        """How long the next reply on a link takes, s."""
        item = self.character
        added = self._chance.expovariate(1.0 / item.jitter_s) if item.jitter_s else 0.0
        return min(item.latency_s + added, 0.25) + (self.switches.delay / 1e3 if self.switches.concern(link) else 0.0)
