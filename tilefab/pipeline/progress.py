"""How the pipeline tells whoever watches what it is doing."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Watches a job; the pipeline never prints."""

    def stage(self, name: str, share: float) -> None:
        """Report that the stage called ``name`` is done to ``share`` (0 to 1)."""
        ...

    def note(self, message: str) -> None:
        """Report something that the operator should know, in a sentence."""
        ...


class Silent:
    """A `Progress` for callers who watch nothing; keeps the notes."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def stage(self, name: str, share: float) -> None:
        """Do nothing."""

    def note(self, message: str) -> None:
        """Keep the note."""
        self.notes.append(message)
