"""Named steps of a tile's way: where a test, or a trace, looks on. Production passes `nothing`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

Probe = Callable[[str], None]
"""Told the name of a step as it is reached; called from whichever thread gets there."""

STEPS: Final = (
    "session.begun",
    "reconcile.read",
    "reconcile.committed",
    "calibrated.committed",
    "intent.before",
    "intent.committed",
    "arm.before",
    "arm.accepted",
    "armed.before",
    "armed.committed",
    "strip.before",
    "strip.sent",
    "face.sent",
    "outcome.read",
    "printed.before",
    "printed.committed",
    "release.before",
    "release.acked",
    "decided.read",
    "decided.before",
    "decided.committed",
    "run.finished",
)
"""In the order in which a tile meets them."""

CORRECTION_STEPS: Final = (
    "correction.before",
    "correction.made",
    "correction.committed",
    "correction.used",
)
"""Of a correction in the middle of a run, beside its tiles: before and after its map is made, once the journal has it,
and once coming faces are printed with it."""


def nothing(step: str) -> None:
    """Look on at nothing."""
