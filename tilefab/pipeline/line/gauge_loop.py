"""The gauge's loop: puts down the colour of each tile that leaves the kiln."""

from __future__ import annotations

from tilefab.devices import GaugeReading, GaugeSession
from tilefab.errors import DeviceRefused
from tilefab.pipeline.line.keeper import JournalKeeper

GAUGED = "gauged"
"""Kind of the journal's note of a reading."""


class GaugeLoop:
    """Talks to the instrument behind the kiln. The line runs without it just as well.

    Parameters
    ----------
    keeper
        The journal.
    """

    def __init__(self, keeper: JournalKeeper) -> None:
        self._keeper = keeper
        self.reading: GaugeReading | None = None

    async def cycle(self, session: GaugeSession) -> None:
        """Read the gauge; a tile that it hasn't told of yet goes into the journal."""
        try:
            reading = await session.measure()
        except DeviceRefused:
            # It answers, but has nothing to tell: no tile lies under it yet.
            return
        before, self.reading = self.reading, reading
        if before is None or reading.tiles == before.tiles:
            return
        await self._keeper.note(GAUGED, tiles=reading.tiles, lab_d50=list(reading.lab_d50))
