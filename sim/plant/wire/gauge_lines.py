"""The gauge's lines of ASCII text: a question with a number, an answer with that number and a checksum."""

from __future__ import annotations

import re
from zlib import crc32

from sim.plant.physics.gauge import Gauge

MOST_LINE = 120
_QUESTION = re.compile(r"\?(\d{1,10}) ([A-Z])")
_UNKNOWN, _NOTHING = 1, 2


def answer(gauge: Gauge, line: bytes) -> bytes | None:
    """Answer a line, without its LF; None for what is no question."""
    match = _QUESTION.fullmatch(line.decode("ascii", "replace").strip("\r"))
    if match is None:
        return None
    seq, command = match.groups()
    reading = gauge.measure() if command == "M" else None
    if reading is not None:
        text = f"{seq} {reading.number} " + " ".join(f"{value:.2f}" for value in reading.lab) + f" {reading.tile}"
    else:
        text = f"{seq} E {_NOTHING if command == 'M' else _UNKNOWN}"
    return f"!{text}*{crc32(text.encode()):08x}\n".encode()
