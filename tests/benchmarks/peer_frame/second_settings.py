"""Characters and fault switches of the second load frame, and the readings that it shows."""

from __future__ import annotations

from dataclasses import dataclass

STILL, MOVING, FAULT = 0, 1, 2


@dataclass
class Character:
    """What a healthy machine is like.

    Attributes:
        seed: of everything drawn.
        stiffness_n_mm: specimen, grips and machine in series, N/mm.
        toe_n: below this load the stiffness is smaller, N.
        toe_part: by this factor.
        slack_mm: travel before any load.
        noise_n, lsb_n, drift_n_s: standard deviation, step and drift of the cell.
        cell_s: the cell gives a new value so often, s; 0: always.
        lag_s: time constant of the cell's filter, s.
        extension_noise_mm, extension_lsb_mm: of the extension.
        latency_s, jitter_s: of a reply: at least, and the mean of what is added.
        start_s: from an order to the begin of motion, s.
        servo_rad_s, damping: of the closed loop in load control.
        speed_mm_s: fastest motion in load control.
        hold_force: the servo holds the load after arrival; else the position is held.
        relax, relax_s: part of the load that relaxes at a constant position, and its time constant, s.
        hunt_n, hunt_hz: amplitude and frequency of the servo at rest.
        sensed: the servo acts on the cell's reading, so a fault of the cell moves the machine; else on the true load.
        pieces: replies are sent byte by byte.
    """

    seed: float = 0
    stiffness_n_mm: float = 20_000.0
    toe_n: float = 0.0
    toe_part: float = 1.0
    slack_mm: float = 0.0
    noise_n: float = 0.05
    lsb_n: float = 0.0
    drift_n_s: float = 0.0
    cell_s: float = 0.0
    lag_s: float = 0.0
    extension_noise_mm: float = 0.0
    extension_lsb_mm: float = 1e-6
    latency_s: float = 0.001
    jitter_s: float = 0.0
    start_s: float = 0.0
    servo_rad_s: float = 25.0
    damping: float = 0.9
    speed_mm_s: float = 0.006
    hold_force: float = 0.0
    relax: float = 0.0
    relax_s: float = 10.0
    hunt_n: float = 0.0
    hunt_hz: float = 1.0
    sensed: float = 0.0
    pieces: float = 0.0


@dataclass
class Switches:
    """Faults; 0 is off. Forces in N, times in s.

    Attributes:
        freeze: the reading of the force is constant, without noise.
        freezeat: the same from this true force on.
        noisyfreeze: the reading is constant except for noise.
        clip: the true force is clipped there, noise is added after.
        sticky: the reading is cut down to a multiple of this.
        flip: the sign of the reading turns within this time.
        fade: the gain of the reading falls to 0 within this time.
        gain: of the reading.
        jump: is added to the reading.
        spike: so many readings are 10,000 N.
        nan, inf: the reading is none.
        lost: the reading is -9999, by which many programs mark a lost value.
        late: delay of the force in its register, s.
        efreeze: the extension is constant.
        ejump: is added to the extension, mm.
        stuckmoving, stuckstill: constant value of the state.
        ratex: motion is so many times as fast.
        targetx: a ramp goes to so many times its target.
        runaway: a ramp does not end.
        wrongway: motion in the other direction.
        jam: no motion, although the state is moving.
        roundtarget: targets are rounded to a multiple of this.
        hiddentarget: the machine goes to this load, and the registers do not show it.
        countback, countstop: the counter of readings decreases, or stops.
        swap: bytes of input registers are swapped.
        stopdelay: a stop is obeyed so much later.
        ignorestop: so many stop orders are not obeyed.
        coast: after a stop it comes to rest within this time.
        creep: the load changes at rest, N/s.
        trip: the machine is in fault and rests.
        hole, mute: nothing is executed and answered; executed, not answered.
        delay: replies come so much later, ms.
        busy: so many reads are answered with exception 6.
        excw: writes but stops are answered with this exception.
        wignore: writes are acknowledged and not taken.
        badtid, wrongunit, wrongfunc, trunc: replies that are not valid.
        enable: only switching the drive off stops it.
        only: number of the link that hole, mute, delay and busy concern; 0: every link.
        nobeat: the watchdog of the device does not expire.
    """

    freeze: float = 0
    freezeat: float = 0
    noisyfreeze: float = 0
    clip: float = 0
    sticky: float = 0
    flip: float = 0
    fade: float = 0
    gain: float = 0
    jump: float = 0
    spike: int = 0
    nan: float = 0
    inf: float = 0
    lost: float = 0
    late: float = 0
    efreeze: float = 0
    ejump: float = 0
    stuckmoving: float = 0
    stuckstill: float = 0
    ratex: float = 0
    targetx: float = 0
    runaway: float = 0
    wrongway: float = 0
    jam: float = 0
    roundtarget: float = 0
    hiddentarget: float = 0
    countback: float = 0
    countstop: float = 0
    swap: float = 0
    stopdelay: float = 0
    ignorestop: int = 0
    coast: float = 0
    creep: float = 0
    trip: float = 0
    hole: float = 0
    mute: float = 0
    delay: float = 0
    busy: int = 0
    excw: int = 0
    wignore: float = 0
    badtid: float = 0
    wrongunit: float = 0
    wrongfunc: float = 0
    trunc: float = 0
    enable: float = 0
    only: float = 0
    nobeat: float = 0

    def concern(self, link: int) -> bool:
        """Whether faults of links act on this one."""
        return self.only in (0, link)


@dataclass(frozen=True)
class Shown:
    """Values of the registers."""

    state: int
    force_n: float
    extension_mm: float
    target_n: float
    counter: int
