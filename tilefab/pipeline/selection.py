"""Which faces an operator asks for."""

from __future__ import annotations

import re
from collections.abc import Sequence

from tilefab.errors import ConfigError, Problem

_PART = re.compile(r"^\s*(?:(\d{1,40})|(\d{0,40})\s*:\s*(\d{0,40}))\s*$", re.ASCII)


def parse_faces(text: str | None, count: int) -> Sequence[int]:
    """Faces named by ``A:B`` (A to B - 1), by single numbers, or by several of these with commas, in that order.

    Parameters
    ----------
    text
        What the operator wrote; ``None`` for all.
    count
        Faces of the job.

    Raises
    ------
    ConfigError
        If it can't be understood or names faces that the job doesn't have.

    Examples
    --------
    >>> list(parse_faces("7,0:3,8:", 10))
    [7, 0, 1, 2, 8, 9]
    """
    if text is None:
        return range(count)
    chosen: dict[int, None] = {}
    parts = text.split(",")
    for part in parts:
        match = _PART.match(part)
        if match is None:
            raise _error(text, f"{part.strip()!r} is not a face or a range; write A:B, for example 0:{min(count, 10)}")
        single, low, high = match.groups()
        first = int(single) if single else int(low or 0)
        end = first + 1 if single else int(high or count)
        if first >= end:
            raise _error(text, f"{part.strip()!r} is empty: B must be larger than A")
        if end > count:
            raise _error(text, f"the job has {count} faces, 0 to {count - 1}; raise count in [tile] for more")
        if len(parts) == 1:
            return range(first, end)
        chosen.update(dict.fromkeys(range(first, end)))
    return list(chosen)


def _error(text: str, message: str) -> ConfigError:
    return ConfigError([Problem(f"--faces {text}", None, "", message)])
