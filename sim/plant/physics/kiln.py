"""The kiln: zones that follow their set-points, tiles that fire, break and come out in another order."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sim.plant.config import ZONES, KilnConfig
from sim.plant.physics.firing import FiringDrift
from sim.plant.physics.tiles import Tile
from sim.plant.physics.timeline import Timeline

ROOM_DEGC = 20.0
_NEAR_DEGC = 5.0
_TOO_HOT_DEGC = 1260.0
_HEATED_DEGC = 100.0
_FIRING_ZONES = slice(5, 7)
# A tile is hottest where the firing zones meet, and is at its peak for a tenth of its way.
_PEAK_FRAC, _SOAK_FRAC = 6 / 8, 0.1


class Zone:
    """One zone: its burner's aim moves to the set-point at most at the ramp limit, its heat follows by first order.

    Parameters
    ----------
    degc
        Temperature and set-point at the start.
    time_constant_s
        How slowly heat follows the burner.
    """

    def __init__(self, degc: float, time_constant_s: float) -> None:
        self._tau = time_constant_s
        self.set_point = degc
        self._t0 = 0.0
        self._heat = self._aim = self._goal = degc
        self._rate = 1.0
        self._drift_t0 = 0.0
        self._drift_from = self._drift_to = 0.0
        self._drift_rate = 0.0

    def head_for(self, t: float, goal: float, rate: float) -> None:
        """From plant time `t` (s) on the burner aims for `goal` (°C) at `rate` (°C/s)."""
        self._heat, self._aim = self._heat_at(t), self._aim_at(t)
        self._t0, self._goal, self._rate = t, goal, rate

    def drift(self, t: float, degc: float, seconds: float) -> None:
        """From plant time `t` (s) on the zone drifts evenly until it is `degc` off after some time; 0: back home."""
        self._drift_from = self._drift_at(t)
        self._drift_t0, self._drift_to = t, degc
        self._drift_rate = abs(degc - self._drift_from) / seconds if seconds > 0 else math.inf

    def temperature(self, t: float) -> float:
        """Temperature in °C at a plant time (s)."""
        return self._heat_at(t) + self._drift_at(t)

    def _drift_at(self, t: float) -> float:
        gap = self._drift_to - self._drift_from
        if not gap or self._drift_rate == math.inf:
            return self._drift_to
        return self._drift_from + math.copysign(min(abs(gap), self._drift_rate * (t - self._drift_t0)), gap)

    def _aim_at(self, t: float) -> float:
        gap = self._goal - self._aim
        return self._aim + math.copysign(min(abs(gap), self._rate * (t - self._t0)), gap)

    def _heat_at(self, t: float) -> float:
        passed, gap = t - self._t0, self._goal - self._aim
        ramp = min(passed, abs(gap) / self._rate)
        slope = math.copysign(self._rate, gap)
        lag = slope * self._tau
        heat = self._aim + slope * ramp - lag + (self._heat - self._aim + lag) * math.exp(-ramp / self._tau)
        if passed <= ramp:
            return heat
        return self._goal + (heat - self._goal) * math.exp(-(passed - ramp) / self._tau)


@dataclass(frozen=True)
class KilnCommand:
    """The command block as it stood when the controller acted on it."""

    cmd_seq: int
    set_points_degc: tuple[float, ...]
    ramp_degc_min: float
    cycle_minutes: float


@dataclass(frozen=True)
class KilnView:
    """What the controller shows."""

    scan_counter: int
    boot_id: int
    heating: bool
    burner_fault: bool
    over_temp: bool
    at_set_point: bool
    blocked: bool
    tiles_inside: int
    cycle_minutes: float
    temperatures_degc: tuple[float, ...]
    cmd_ack: int


class Kiln:
    """The kiln and its controller.

    Parameters
    ----------
    timeline
        The plant's clock.
    config
        How it fires.
    boots
        Where boot identities come from.
    on_out
        Called with each tile that comes out, and whether it is whole.
    on_room
        Called with whether the kiln is full, whenever a tile goes in or out.
    drift
        How firing differs from normal besides; None if nobody looks at colours.
    """

    def __init__(
        self,
        timeline: Timeline,
        config: KilnConfig,
        boots: random.Random,
        on_out: Callable[[Tile, bool], None],
        on_room: Callable[[bool], None],
        drift: FiringDrift | None = None,
    ) -> None:
        self._drift = drift
        self._timeline = timeline
        self._config = config
        self._boots = boots
        self._on_out = on_out
        self._on_room = on_room
        start = config.zones_degc or (config.start_degc,) * ZONES
        self.zones = [Zone(degc, config.time_constant_min * 60) for degc in start]
        self._peak_degc = config.peak_degc or _mean(start[_FIRING_ZONES])
        self.ramp_degc_min = 10.0
        self.cycle_minutes = config.cycle_minutes
        self.inside = 0
        self.burner_fault = self.blocked = self._hung = False
        self._waiting: KilnCommand | None = None
        self.boot_id = 0
        self.up = False
        self.power_up()

    def power_up(self) -> None:
        """Start; set-points are remembered without power, as controllers of kilns do."""
        old = self.boot_id
        while self.boot_id in (0, old):
            self.boot_id = self._boots.randrange(1, 1 << 16)
        self.up = True
        self._boot_wall = self._timeline.wall
        self._cmd_ack = 0
        self._last: int | None = None
        self._hung = False
        self._waiting = None
        self._aim()

    def power_down(self, *, forget: bool = False) -> None:
        """Lose power: burners go out; `forget` loses the set-points too."""
        self.up = False
        if forget:
            for zone in self.zones:
                zone.set_point = ROOM_DEGC
            self.ramp_degc_min, self.cycle_minutes = 10.0, self._config.cycle_minutes
        self._aim()

    def command(self, command: KilnCommand) -> None:
        """Act on a command block if it is newer than the last; a program that hangs does so once it goes on."""
        if self._hung:
            self._waiting = command
            return
        if self._last is not None and not 0 < (command.cmd_seq - self._last) % 65536 < 32768:
            return
        self._last = self._cmd_ack = command.cmd_seq
        for zone, degc in zip(self.zones, command.set_points_degc, strict=True):
            zone.set_point = degc
        self.ramp_degc_min, self.cycle_minutes = command.ramp_degc_min, command.cycle_minutes
        self._aim()

    def hang(self, hung: bool) -> None:
        """The program hangs, or goes on."""
        waiting, self._waiting, self._hung = self._waiting, None, hung
        if waiting is not None and not hung:
            self.command(waiting)

    def fail_burner(self, failed: bool) -> None:
        """The burner goes out, or is lit again."""
        self.burner_fault = failed
        self._aim()

    def drift(self, zone: int, degc: float, minutes: float) -> None:
        """A zone drifts until it is off by some °C, within some minutes; by 0 °C it comes back."""
        self.zones[zone].drift(self._timeline.t, degc, minutes * 60)

    def _aim(self) -> None:
        lit = self.up and not self.burner_fault
        for zone in self.zones:
            goal = zone.set_point if lit else ROOM_DEGC
            zone.head_for(self._timeline.t, goal, self.ramp_degc_min / 60)

    def enter(self, tile: Tile) -> None:
        """A tile goes in; when it comes out, and whether whole, depends on the seed and the tile alone."""
        config = self._config
        chance = random.Random(f"{config.seed}:{tile.id}")
        minutes = self.cycle_minutes + chance.uniform(-1, 1) * config.shuffle_minutes
        minutes = min(max(minutes, config.least_minutes), config.most_minutes)
        whole = chance.random() >= config.break_rate
        self.inside += 1
        self._on_room(self.inside >= config.capacity)
        drift, now = self._drift, self._timeline.t
        if drift is not None:
            self._timeline.at_time(now + _PEAK_FRAC * minutes * 60, lambda: self._fire(tile, drift, minutes))
        self._timeline.at_time(now + minutes * 60, lambda: self._leave(tile, whole))

    def _fire(self, tile: Tile, drift: FiringDrift, minutes: float) -> None:
        t = self._timeline.t
        hotter = _mean(self.temperatures()[_FIRING_ZONES]) - self._peak_degc
        longer = _SOAK_FRAC * (minutes - (self._config.normal_minutes or self._config.cycle_minutes))
        tile.fired = drift.fired(t, tile.laid or drift.laid(t), hotter, longer)

    def _leave(self, tile: Tile, whole: bool) -> None:
        if self.blocked:
            self._timeline.at_time(self._timeline.t + 60, lambda: self._leave(tile, whole))
            return
        self.inside -= 1
        self._on_room(self.inside >= self._config.capacity)
        self._on_out(tile, whole)

    def temperatures(self) -> list[float]:
        """Temperatures of the zones now, °C."""
        return [zone.temperature(self._timeline.t) for zone in self.zones]

    def view(self) -> KilnView:
        """What the controller shows now."""
        degc = tuple(self.temperatures())
        return KilnView(
            scan_counter=int((self._timeline.wall - self._boot_wall) * 100) & 0xFFFF,
            boot_id=self.boot_id,
            heating=self.up and not self.burner_fault and max(zone.set_point for zone in self.zones) > _HEATED_DEGC,
            burner_fault=self.burner_fault,
            over_temp=max(degc) > _TOO_HOT_DEGC,
            at_set_point=all(
                abs(now - zone.set_point) <= _NEAR_DEGC for now, zone in zip(degc, self.zones, strict=True)
            ),
            blocked=self.blocked,
            tiles_inside=self.inside,
            cycle_minutes=self.cycle_minutes,
            temperatures_degc=degc,
            cmd_ack=self._cmd_ack,
        )


def _mean(degc: Sequence[float]) -> float:
    return sum(degc) / len(degc)
