"""How long to wait before the next attempt to reach a device."""

from __future__ import annotations


class Backoff:
    """Pauses that double from the first to the longest, and begin anew after a success.

    Parameters
    ----------
    first, most
        Seconds. ``most`` bounds how late a device that is back is noticed, so it stays short.
    """

    def __init__(self, first: float = 0.05, most: float = 0.5) -> None:
        if not 0 < first <= most:
            raise ValueError("the first pause must be above 0 and at most the longest")
        self._first, self._most = first, most
        self._next = first

    def next_s(self) -> float:
        """Give the next pause in seconds."""
        pause = self._next
        self._next = min(2 * pause, self._most)
        return pause

    def reset(self) -> None:
        """Begin with the first pause again."""
        self._next = self._first
