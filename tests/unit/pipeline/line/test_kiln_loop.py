from __future__ import annotations

import asyncio
import itertools
from dataclasses import replace
from typing import Any, cast

import pytest

from tilefab.control.ramp import RampLimits
from tilefab.devices import KilnCommand, KilnSession, KilnStatus
from tilefab.pipeline.line.host import LineHost
from tilefab.pipeline.line.kiln_loop import KilnLoop, KilnRecipe

LIMITS = RampLimits(100.0, 1200.0, 6.0)
COLD = KilnStatus(
    boot_id=1,
    heating=False,
    burner_fault=False,
    over_temp=False,
    at_set_point=True,
    blocked=False,
    tiles_inside=0,
    cycle_time_min=45.0,
    temperatures_degc=(500.0,) * 8,
    set_points_degc=(500.0,) * 8,
    ramp_limit_degc_min=6.0,
)


class Host:
    """What the loop tells."""

    def __init__(self) -> None:
        self.moving = True
        self.told: list[str] = []

    def doubt(self, code: str, _: str) -> None:
        self.told.append(code)

    def warn(self, code: str, reason: str) -> None:
        self.told.append(f"{code}: {reason}")


class Kiln:
    """A kiln that is at its set-points at once, and a clock that is set by hand."""

    def __init__(self) -> None:
        self.status = COLD
        self.commands: list[KilnCommand] = []
        self.now_s = 1000.0
        self.host = Host()
        self.noted: list[tuple[float, dict[str, Any]]] = []
        self.loop = KilnLoop(cast(LineHost, self.host), LIMITS, 5.0, self.note)

    def note(self, kind: str, **facts: object) -> None:
        assert kind == "kiln"
        self.noted.append((self.now_s, facts))

    async def poll(self) -> KilnStatus:
        return self.status

    async def command(self, command: KilnCommand) -> KilnStatus:
        self.commands.append(command)
        self.status = replace(
            self.status,
            set_points_degc=tuple(command.set_points_degc),
            temperatures_degc=tuple(command.set_points_degc),
            cycle_time_min=command.cycle_min,
        )
        return self.status

    def go_round(self, times: int = 1, *, every_s: float = 0.5) -> None:
        async def work() -> None:
            loop = asyncio.get_running_loop()
            loop.time = lambda: self.now_s  # type: ignore[method-assign]
            await self.loop.cycle(cast(KilnSession, cast(Any, self)))

        for _ in range(times):
            asyncio.run(work())
            self.now_s += every_s


def test_set_points_move_no_faster_than_the_ramp() -> None:
    kiln = Kiln()
    kiln.loop.bring_to(KilnRecipe((530.0,) * 8, 40.0))
    kiln.go_round(30, every_s=10.0)
    at = [500.0, *(command.set_points_degc[0] for command in kiln.commands)]
    # 6 °C a minute is 1 °C in the ten seconds between two steps.
    assert max(after - before for before, after in itertools.pairwise(at)) <= 1.0 + 1e-9
    assert not kiln.loop.at_recipe
    kiln.go_round()
    assert kiln.loop.at_recipe
    assert kiln.status.set_points_degc == (530.0,) * 8
    assert kiln.status.cycle_time_min == 40.0
    assert len(kiln.commands) == 30


def test_steps_are_ten_seconds_apart_however_often_the_kiln_is_asked() -> None:
    kiln = Kiln()
    kiln.loop.bring_to(KilnRecipe((530.0,) * 8, None))
    kiln.go_round(41, every_s=0.5)
    assert len(kiln.commands) == 3


def test_a_kiln_with_tiles_in_it_keeps_their_firing_until_they_are_out() -> None:
    kiln = Kiln()
    kiln.status = replace(COLD, tiles_inside=3)
    kiln.loop.bring_to(KilnRecipe((501.0,) * 8, None))
    kiln.go_round(5, every_s=10.0)
    assert not kiln.commands
    assert not kiln.loop.at_recipe
    kiln.status = replace(kiln.status, tiles_inside=0)
    kiln.go_round()
    assert len(kiln.commands) == 1


def test_a_ramp_that_was_begun_goes_on_with_tiles_inside() -> None:
    kiln = Kiln()
    kiln.loop.bring_to(KilnRecipe((503.0,) * 8, None))
    kiln.go_round(every_s=10.0)
    kiln.status = replace(kiln.status, tiles_inside=1)
    kiln.go_round(4, every_s=10.0)
    assert kiln.loop.at_recipe


def test_a_recipe_without_set_points_changes_the_firing_time_only() -> None:
    kiln = Kiln()
    kiln.loop.bring_to(KilnRecipe(None, 60.0))
    kiln.go_round(2)
    assert kiln.status.set_points_degc == COLD.set_points_degc
    assert kiln.status.cycle_time_min == 60.0
    assert kiln.loop.at_recipe


def test_a_kiln_that_is_right_already_is_left_alone() -> None:
    kiln = Kiln()
    assert not kiln.loop.at_recipe
    kiln.loop.bring_to(KilnRecipe((500.0,) * 8, 45.0))
    kiln.go_round(3)
    assert kiln.loop.at_recipe
    assert not kiln.commands


def test_a_zone_that_is_not_there_yet_keeps_tiles_out() -> None:
    kiln = Kiln()
    kiln.status = replace(COLD, temperatures_degc=(*(500.0,) * 7, 494.0))
    kiln.loop.bring_to(KilnRecipe((500.0,) * 8, None))
    kiln.go_round()
    assert not kiln.loop.at_recipe


@pytest.mark.parametrize(
    ("fault", "code"), [("burner_fault", "kiln_burner"), ("over_temp", "kiln_over_temp"), ("blocked", "kiln_blocked")]
)
def test_faults_of_the_kiln_hold_a_line_that_moves(fault: str, code: str) -> None:
    kiln = Kiln()
    kiln.status = replace(COLD, **{fault: True})
    kiln.host.moving = False
    kiln.go_round()
    assert not kiln.host.told
    kiln.host.moving = True
    kiln.go_round()
    assert kiln.host.told == [code]


def test_a_zone_that_drifts_is_told_of_once_and_again_after_it_was_right() -> None:
    kiln = Kiln()
    kiln.loop.bring_to(KilnRecipe((500.0,) * 8, None))
    for _ in range(2):
        kiln.status = replace(kiln.status, temperatures_degc=(500.0, 510.0, *(500.0,) * 6))
        kiln.go_round(30)
        kiln.status = replace(kiln.status, temperatures_degc=(500.0,) * 8)
        kiln.go_round(2)
    assert kiln.host.told == ["kiln_zone: zone 2 of the kiln is at 510 °C, 500 wanted"] * 2


def test_zones_are_noted_when_they_move_but_not_too_often_and_now_and_then_in_any_case() -> None:
    kiln = Kiln()

    def zone(degc: float) -> None:
        kiln.status = replace(kiln.status, temperatures_degc=(*(500.0,) * 7, degc))

    kiln.go_round(241)  # two minutes at rest
    assert [at for at, _ in kiln.noted] == [1000.0, 1060.0, 1120.0]
    assert kiln.noted[0][1] == {"temperatures_degc": [500.0] * 8, "set_points_degc": [500.0] * 8}
    kiln.noted.clear()
    zone(500.4)
    kiln.go_round(10)
    assert not kiln.noted, "less than half a degree"
    for number in range(12):
        zone(501.04 + number)
        kiln.go_round()
    assert [at - kiln.noted[0][0] for at, _ in kiln.noted] == [0.0, 2.0, 4.0]
    assert kiln.noted[0][1]["temperatures_degc"][7] == 501.0
    kiln.go_round(20)
    kiln.noted.clear()
    kiln.status = replace(kiln.status, set_points_degc=(505.0,) * 8)
    kiln.go_round()
    assert kiln.noted[0][1]["set_points_degc"] == [505.0] * 8
