"""Faces sent over a link that does as it is told."""

from __future__ import annotations

import threading
import zlib
from collections.abc import Iterator
from typing import cast

import numpy as np
import pytest

from tilefab.errors import DeviceRefused, DeviceTimeout, TilefabError
from tilefab.pipeline.faces import PlannedFace
from tilefab.pipeline.line.source import FaceSource, Strip
from tilefab.pipeline.line.streaming import Streamer
from tilefab.types import SizePx

ROWS, STRIP = 10, 4
PIXELS = np.random.default_rng(1).integers(0, 256, (ROWS, 6, 4), dtype=np.uint8)
WHOLE = zlib.crc32(PIXELS.tobytes())


class Source:
    """One face, whatever its number."""

    size = SizePx(ROWS, 6)

    def prepare(self, face: int) -> PlannedFace:
        return cast(PlannedFace, face)

    def strips(self, planned: PlannedFace, first: int = 0, correction: int = 0) -> Iterator[Strip]:
        assert (planned, correction) == (7, 3)
        for row in range(first, ROWS, STRIP):
            yield Strip(row, PIXELS[row : row + STRIP])


class Link:
    """Keeps what it is sent."""

    def __init__(self, first: int = 0, *, refuses: bool = False, fails_at: int | None = None) -> None:
        self.first, self.refuses, self.fails_at = first, refuses, fails_at
        self.rows: list[tuple[int, bytes]] = []

    def open(self, timeout_s: float) -> None:
        assert timeout_s > 0

    def close(self) -> None:
        pass

    def next_row(self, arm_id: int) -> int:
        assert arm_id == 1
        if self.refuses:
            raise DeviceRefused("no such arm")
        return self.first

    def send_strip(self, arm_id: int, row: int, rows: int, data: memoryview, *, timeout_s: float) -> int:
        if row == self.fails_at:
            raise DeviceTimeout("gone")
        assert arm_id == 1
        assert timeout_s > 1
        assert len(data) == rows * 24
        self.rows.append((row, bytes(data)))
        return zlib.crc32(data)


def stream(*links: Link) -> tuple[int | None, list[TilefabError]]:
    """Send a face, over one link after the other; its checksum as it was kept, and what went wrong."""
    trouble: list[TilefabError] = []
    ended = threading.Event()

    def tell(error: TilefabError) -> None:
        trouble.append(error)
        ended.set()

    waiting = list(links)
    streamer = Streamer(cast(FaceSource, Source()), lambda: waiting.pop(0), tell)
    try:
        streamer.submit(1, 7, 3)
        for _ in range(1000):
            if streamer.checksum(1) is not None or ended.wait(0.005):
                break
        return streamer.checksum(1), trouble
    finally:
        streamer.close()


def test_a_face_is_sent_in_order_and_summed_up() -> None:
    link = Link()
    assert stream(link) == (WHOLE, [])
    assert [row for row, _ in link.rows] == [0, 4, 8]
    assert b"".join(data for _, data in link.rows) == PIXELS.tobytes()


@pytest.mark.parametrize("first", [4, 6, 8, 9, 10])
def test_what_the_printer_has_already_is_summed_up_but_not_sent(first: int) -> None:
    link = Link(first)
    assert stream(link) == (WHOLE, [])
    assert b"".join(data for _, data in link.rows) == PIXELS[first:].tobytes()


def test_a_face_that_the_printer_has_done_with_is_still_summed_up() -> None:
    link = Link(refuses=True)
    assert stream(link) == (WHOLE, [])
    assert not link.rows


def test_a_lost_link_is_replaced_and_the_face_gone_on_with() -> None:
    first, second = Link(fails_at=4), Link(4)
    assert stream(first, second) == (WHOLE, [])
    assert [row for row, _ in first.rows + second.rows] == [0, 4, 8]


def test_after_several_lost_links_the_line_is_told() -> None:
    found, trouble = stream(*(Link(fails_at=0) for _ in range(4)))
    assert found is None
    assert [error.message for error in trouble] == ["gone"]
