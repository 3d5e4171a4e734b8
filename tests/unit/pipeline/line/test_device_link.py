from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

import pytest

from tilefab.errors import DeviceError, DeviceRefused, DeviceTimeout
from tilefab.pipeline.line.device_link import DeviceLink

PERIOD_S = 0.004
PATIENCE_S = 5.0


@dataclass
class Device:
    """A device whose next answers are written down; without any it answers well."""

    answers: list[DeviceError | None] = field(default_factory=list)
    silent: bool = False
    refuses_connections: int = 0
    sessions: int = 0
    open_sessions: int = 0
    greetings: int = 0
    cycles: int = 0
    told: list[str] = field(default_factory=list)


class Session:
    def __init__(self, device: Device) -> None:
        self._device = device
        self._open = False

    @property
    def connected(self) -> bool:
        return self._open

    async def connect(self) -> None:
        self._device.sessions += 1
        if self._device.refuses_connections:
            self._device.refuses_connections -= 1
            raise DeviceTimeout("nobody there", device="it")
        self._open = True
        self._device.open_sessions += 1

    async def close(self) -> None:
        self._device.open_sessions -= self._open
        self._open = False

    def lose(self) -> None:
        """Lose the connection."""
        self._device.open_sessions -= self._open
        self._open = False


def run(device: Device, work: Callable[[DeviceLink[Session]], Awaitable[None]]) -> None:
    async def greet(_: Session) -> None:
        device.greetings += 1

    async def cycle(session: Session) -> None:
        device.cycles += 1
        if device.silent:
            raise DeviceTimeout("silent", device="it")
        answer = device.answers.pop(0) if device.answers else None
        if answer is not None:
            if isinstance(answer, DeviceTimeout):
                session.lose()
            raise answer

    async def whole() -> None:
        link = DeviceLink(
            "it",
            lambda: Session(device),
            begin=greet,
            cycle=cycle,
            period_s=PERIOD_S,
            lost=lambda name, why: device.told.append(f"{name} lost: {why}"),
            back=lambda name: device.told.append(f"{name} back"),
        )
        running = asyncio.create_task(link.run())
        try:
            async with asyncio.timeout(PATIENCE_S):
                await work(link)
        finally:
            running.cancel()
            with pytest.raises(asyncio.CancelledError):
                await running
        assert device.open_sessions == 0, "a session was left open"

    asyncio.run(whole())


async def until(seen: Callable[[], object]) -> None:
    while not seen():
        await asyncio.sleep(0.001)


def test_a_device_that_answers_is_told_of_once() -> None:
    device = Device()

    async def work(link: DeviceLink[Session]) -> None:
        assert not link.present
        assert link.facts.last_seen_s is None
        await until(lambda: link.turns > 3)
        assert link.present
        assert link.facts.errors == 0

    run(device, work)
    assert device.told == ["it back"]
    assert (device.sessions, device.greetings) == (1, 1)


def test_one_wrong_answer_is_counted_and_costs_nothing() -> None:
    device = Device([None, DeviceError("nonsense", device="it")])

    async def work(link: DeviceLink[Session]) -> None:
        await until(lambda: link.turns > 3)
        assert (link.facts.errors, link.facts.last_error) == (1, "nonsense")

    run(device, work)
    assert device.told == ["it back"]
    assert device.sessions == 1


def test_a_lost_connection_is_made_anew_and_greeted_before_the_device_counts_as_lost() -> None:
    device = Device([None, DeviceTimeout("gone", device="it")])

    async def work(link: DeviceLink[Session]) -> None:
        await until(lambda: link.turns > 3)

    run(device, work)
    assert device.told == ["it back"]
    assert (device.sessions, device.greetings) == (2, 2)


def test_a_device_that_refuses_is_greeted_anew() -> None:
    device = Device([None, DeviceRefused("who are you", device="it")])

    async def work(link: DeviceLink[Session]) -> None:
        await until(lambda: link.turns > 3)

    run(device, work)
    assert (device.sessions, device.greetings) == (2, 2)


def test_a_silent_device_is_lost_and_comes_back() -> None:
    device = Device()

    async def work(link: DeviceLink[Session]) -> None:
        await until(lambda: link.present)
        device.silent = True
        await until(lambda: not link.present)
        device.silent = False
        await until(lambda: link.present)

    run(device, work)
    assert device.told == ["it back", "it lost: silent", "it back"]


def test_a_device_that_is_not_there_yet_is_never_lost() -> None:
    device = Device(refuses_connections=3)

    async def work(link: DeviceLink[Session]) -> None:
        await until(lambda: link.turns)
        assert link.facts.errors == 3

    run(device, work)
    assert device.told == ["it back"]


def test_a_renewed_session_is_another_one_and_the_device_is_not_lost() -> None:
    device = Device()

    async def work(link: DeviceLink[Session]) -> None:
        await until(lambda: link.present)
        link.renew()
        await until(lambda: device.greetings == 2)
        await until(lambda: link.turns > 3)

    run(device, work)
    assert device.told == ["it back"]
    assert device.sessions == 2


def test_a_link_in_a_hurry_goes_round_at_once() -> None:
    device = Device()

    async def work(link: DeviceLink[Session]) -> None:
        link.period_s = 60.0
        await until(lambda: link.turns == 1)
        for wanted in range(2, 6):
            link.hurry()
            await until(lambda wanted=wanted: link.turns == wanted)

    run(device, work)


def test_a_defect_of_a_cycle_ends_the_link_and_closes_its_session() -> None:
    device = Device()

    async def cycle(_: Session) -> None:
        raise ZeroDivisionError

    async def whole() -> None:
        link = DeviceLink(
            "it",
            lambda: Session(device),
            cycle=cycle,
            period_s=PERIOD_S,
            lost=lambda _name, _why: None,
            back=lambda _name: None,
        )
        with pytest.raises(ZeroDivisionError):
            await link.run()

    asyncio.run(whole())
    assert device.open_sessions == 0
