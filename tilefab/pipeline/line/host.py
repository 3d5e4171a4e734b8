"""What the loops of the devices tell the line, and what they may do."""

from __future__ import annotations

from typing import Protocol

from tilefab.pipeline.line.book import FaceBook
from tilefab.pipeline.line.streaming import Streamer


class LineHost(Protocol):
    """The line, as seen by the loops of its devices."""

    @property
    def may_print(self) -> bool:
        """Whether tiles get faces."""

    @property
    def moving(self) -> bool:
        """Whether the line is meant to move, so that whatever stops it is worth an alarm."""

    @property
    def book(self) -> FaceBook | None:
        """Faces of the present run."""

    @property
    def streamer(self) -> Streamer | None:
        """Where faces of accepted arms are sent from."""

    def e_stop(self, device: str, pressed: bool) -> None:
        """Tell that a device's emergency stop was pressed or let go."""

    def doubt(self, code: str, reason: str) -> None:
        """Tell that something isn't as it must be: the line holds."""

    def tiles_moved(self, code: str) -> None:
        """Tell that tiles may lie elsewhere than the counts say."""

    @property
    def spoilt(self) -> bool:
        """Whether ink or a nozzle failed since the line was brought up."""

    def print_spoilt(self, code: str) -> None:
        """Tell that ink or a nozzle failed: what is under the head may lack ink."""

    def fault(self, code: str, reason: str) -> None:
        """Tell that the line can't go on: it stops."""

    def warn(self, code: str, reason: str) -> None:
        """Tell of something an operator should see, without stopping for it."""

    def faces_wanted(self) -> None:
        """Ask for more faces to be put down in the journal."""

    def releases_wanted(self) -> None:
        """Ask for tiles to be released as soon as can be."""

    def tile_done(self, passed: bool) -> None:
        """Tell that a tile with a face was decided."""
