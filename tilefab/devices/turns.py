"""One request at a time: who asks a device waits for the turn, within the deadline of the request."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from tilefab.errors import DeviceTimeout


class Turns:
    """Gives one asker at a time the turn.

    Parameters
    ----------
    deadline_s
        Of each request, in seconds, waiting included.
    device
        Name of the device, for messages.
    """

    def __init__(self, deadline_s: float, device: str) -> None:
        self._deadline_s, self._device = deadline_s, device
        self._lock = asyncio.Lock()

    @asynccontextmanager
    async def mine(self) -> AsyncIterator[float]:
        """Wait for the turn; gives the time, on the loop's clock, by which the request must be answered.

        Raises
        ------
        DeviceTimeout
            If the turn comes so late that less than a quarter of the deadline is left: an answer that comes too late
            does more harm than a request that is never sent.
        """
        loop = asyncio.get_running_loop()
        begin = loop.time()
        try:
            async with asyncio.timeout_at(begin + 0.75 * self._deadline_s):
                await self._lock.acquire()
        except TimeoutError:
            raise DeviceTimeout(f"{self._device}: is still busy with an earlier request", device=self._device) from None
        try:
            yield begin + self._deadline_s
        finally:
            self._lock.release()
