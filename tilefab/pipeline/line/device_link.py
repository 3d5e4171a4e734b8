"""Keeps one device connected and asked in turn, and tells when it was lost and when it is back."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from tilefab.devices import Backoff
from tilefab.errors import DeviceError, DeviceRefused

LOST_AFTER_S = 0.35
"""Without a sound answer for this long after one is due, a device is lost: a request and a new connection fit in."""


class Session(Protocol):
    """What a link needs of a device's session."""

    async def connect(self) -> None:
        """Connect."""

    async def close(self) -> None:
        """Disconnect."""

    @property
    def connected(self) -> bool:
        """Whether there is a connection that can be trusted."""


S = TypeVar("S", bound=Session)


@dataclass(frozen=True)
class LinkFacts:
    """How a link is doing.

    Attributes
    ----------
    connected
        Whether the device counts as being there.
    last_seen_s
        Seconds since its last sound answer; ``None`` if there was none.
    errors
        Failed requests and connections since the daemon started.
    last_error
        The last of them.
    """

    connected: bool
    last_seen_s: float | None
    errors: int
    last_error: str


class DeviceLink(Generic[S]):
    """Runs cycles of requests against a device for as long as the daemon lives.

    Parameters
    ----------
    name
        Of the device.
    make
        Makes a new session, not yet connected.
    begin
        Called with each newly connected session before any cycle.
    cycle
        One round of requests.
    period_s
        From the beginning of a cycle to that of the next.
    lost, back
        Called when the device is lost, with the last error, and when it is back.
    """

    def __init__(
        self,
        name: str,
        make: Callable[[], S],
        *,
        cycle: Callable[[S], Awaitable[None]],
        period_s: float,
        lost: Callable[[str, str], None],
        back: Callable[[str], None],
        begin: Callable[[S], Awaitable[None]] | None = None,
    ) -> None:
        self.name, self.period_s = name, period_s
        self._make, self._begin, self._cycle, self._lost, self._back = make, begin, cycle, lost, back
        self._session: S | None = None
        self._last_good: float | None = None
        self._present = False
        self._errors = 0
        self._last_error = ""
        self._wake = asyncio.Event()
        self._patience: asyncio.TimerHandle | None = None
        self._renew = False
        self.turns = 0
        """Sound cycles so far."""
        self.rounds = 0
        """Cycles begun so far, sound or not."""

    @property
    def facts(self) -> LinkFacts:
        """How it is doing."""
        now = asyncio.get_running_loop().time()
        seen = None if self._last_good is None else now - self._last_good
        return LinkFacts(self._present, seen, self._errors, self._last_error)

    @property
    def present(self) -> bool:
        """Whether the device answers."""
        return self._present

    def hurry(self) -> None:
        """Begin the next cycle at once."""
        self._wake.set()

    def renew(self) -> None:
        """Give the session up and make a new one before the next cycle; the device doesn't count as lost."""
        self._renew = True
        self._wake.set()

    async def run(self) -> None:
        """Ask in turn until cancelled."""
        loop = asyncio.get_running_loop()
        self._last_good = None
        backoff = Backoff()
        try:
            while True:
                self.rounds += 1
                due = loop.time() + self.period_s
                try:
                    session = await self._connected_session()
                    await self._cycle(session)
                except DeviceError as error:
                    self._errors += 1
                    self._last_error = error.message
                    # A device that refuses may have been restarted, and know nothing of this session any more.
                    refused = isinstance(error, DeviceRefused)
                    if self._session is None or not self._session.connected or refused:
                        await self._drop()
                        due = loop.time() + backoff.next_s()
                else:
                    self._last_good = loop.time()
                    self._expect_more(loop)
                    self.turns += 1
                    backoff.reset()
                    if not self._present:
                        self._present = True
                        self._back(self.name)
                await self._rest(due)
        finally:
            if self._patience is not None:
                self._patience.cancel()
            await self._drop()

    def _expect_more(self, loop: asyncio.AbstractEventLoop) -> None:
        """Count the device as lost if no sound answer follows in time, whatever is being waited for then."""
        if self._patience is not None:
            self._patience.cancel()
        self._patience = loop.call_later(self.period_s + LOST_AFTER_S, self._out_of_patience)

    def _out_of_patience(self) -> None:
        self._patience = None
        if self._present:
            self._present = False
            self._lost(self.name, self._last_error or "no answer")

    async def _connected_session(self) -> S:
        if self._renew:
            self._renew = False
            await self._drop()
        if self._session is None:
            session = self._make()
            try:
                await session.connect()
                if self._begin is not None:
                    await self._begin(session)
            except BaseException:
                await session.close()
                raise
            self._session = session
        return self._session

    async def _drop(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            await session.close()

    async def _rest(self, due: float) -> None:
        left = due - asyncio.get_running_loop().time()
        if left <= 0:
            # Also then the others get their turn.
            await asyncio.sleep(0)
            self._wake.clear()
            return
        # Not `asyncio.wait_for`: when both come at once, that of Python 3.11 takes a wake for a cancellation's end.
        with suppress(TimeoutError):
            async with asyncio.timeout(left):
                await self._wake.wait()
        self._wake.clear()
