"""Numbers that must not come twice, and what was last seen moving, kept for each endpoint as long as the process lives.

They outlive a session: a reply to a request of the session before must not fit a request of this one, and a device that
stood still doesn't count as alive because it was connected anew.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field

_LAST = 0xFFFF


def _anywhere() -> int:
    return secrets.randbelow(_LAST) + 1


@dataclass
class Memory:
    """What is remembered of one endpoint.

    Attributes
    ----------
    sequence
        Last number given out, from 1 to 65535; begins anywhere, so that replies to an earlier process don't fit either.
    boot_id, scan
        The device's, when it was last heard.
    scan_since_s
        Since when its scan counter has stood there, in the loop's time; ``None`` if it was never heard.
    """

    sequence: int = field(default_factory=_anywhere)
    boot_id: int = 0
    scan: int = 0
    scan_since_s: float | None = None

    def next_sequence(self) -> int:
        """Give out the next number; each comes once in 65535."""
        self.sequence = self.sequence % _LAST + 1
        return self.sequence

    def still_for_s(self, boot_id: int, scan: int, now: float) -> float:
        """For how long the scan counter has stood still, in seconds."""
        if self.scan_since_s is None or (boot_id, scan) != (self.boot_id, self.scan):
            self.boot_id, self.scan, self.scan_since_s = boot_id, scan, now
        return now - self.scan_since_s


_memories: dict[str, Memory] = {}


def memory_of(endpoint: str) -> Memory:
    """Find what is remembered of an endpoint."""
    return _memories.setdefault(endpoint, Memory())
