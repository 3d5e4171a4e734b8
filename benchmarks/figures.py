"""Tables of figures beside what they are to reach."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import delta_e_2000

WIDTH = 62


class Figures:
    """Prints rows as they come, and remembers how many of the figures to reach were reached."""

    def __init__(self) -> None:
        self.reached = self.judged = 0

    def title(self, text: str) -> None:
        """Begin a table."""
        print(f"\n{text}\n{'-' * len(text.splitlines()[-1])}", flush=True)

    def row(self, what: str, values: Sequence[float], to_reach: Sequence[float] | None = None, note: str = "") -> None:
        """Values beside the most that each may be; without those they are only for comparison."""
        shown = " / ".join(f"{value:.3f}" for value in values)
        verdict = ""
        if to_reach is not None:
            good = all(value <= most for value, most in zip(values, to_reach, strict=True))
            verdict = f"  to reach {' / '.join(f'{most:g}' for most in to_reach)}: {self._said(good)}"
        print(f"{what:<{WIDTH}} {shown}{verdict}{'  ' + note if note else ''}", flush=True)

    def check(self, what: str, shown: str, good: bool, wanted: str) -> None:
        """A figure of its own kind."""
        print(f"{what:<{WIDTH}} {shown}  to reach {wanted}: {self._said(good)}", flush=True)

    def note(self, what: str, shown: str) -> None:
        """A figure for comparison, or why there is none."""
        print(f"{what:<{WIDTH}} {shown}", flush=True)

    def end(self) -> None:
        """Say how many were reached."""
        print(f"\n{self.reached} of {self.judged} figures reached")

    def _said(self, good: bool) -> str:
        self.judged += 1
        self.reached += good
        return "reached" if good else "NOT reached"


def mean_p95(one: NDArray[np.floating], other: NDArray[np.floating]) -> tuple[float, float]:
    """Mean and 95th percentile of CIEDE2000."""
    delta_e = delta_e_2000(one, other)
    return float(delta_e.mean()), float(np.percentile(delta_e, 95))
