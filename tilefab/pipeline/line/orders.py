"""What may be ordered of a line, by its operator or by whoever inspects its tiles, and what the daemon offers them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from tilefab.control.ledger import MOST_FACES, ArmState
from tilefab.pipeline.line.alarms import FROM_INSPECTION
from tilefab.pipeline.line.status import AlarmView, CorrectionView, FaceView, LineStatus

MOST_FACES_TOLD = 200
"""Most faces that `LineControl.faces` is asked for."""

MOST_CORRECTIONS_TOLD = 200
"""Most corrections that `LineControl.corrections` tells: the newest."""

SETTLED = (ArmState.PASSED, ArmState.DIVERTED, ArmState.UNPRINTED)
"""What an operator may say became of a face in doubt."""

_LONGEST_PATH = 4096
_LONGEST_TEXT = 500
_MOST_ALARMS = 1 << 53


class LineControl(Protocol):
    """A line's daemon, as seen by those that talk to it. Called from its own loop."""

    def status(self) -> LineStatus:
        """How the line is doing."""

    async def command(self, name: str, arguments: Mapping[str, object]) -> str:
        """Carry out an order that `check_order` let through; what was done, in a line.

        Raises
        ------
        TilefabError
            If the line can't do so now.
        """

    def metrics(self) -> bytes:
        """What Prometheus is told; see `tilefab.pipeline.line.metrics`."""

    async def faces(self, last: int) -> Sequence[FaceView]:
        """The latest attempts to print a face, newest first."""

    def alarms(self) -> Sequence[AlarmView]:
        """Alarms that are up, oldest first."""

    async def correct(self, run_id: int, drift: Mapping[str, object], reason: str) -> int:
        """Correct the colours of coming faces; see `tilefab.pipeline.line.correcting.Corrector.correct`.

        Raises
        ------
        TilefabError
            If the line can't do so now.
        """

    async def corrections(self, run_id: int | None) -> tuple[int, Sequence[CorrectionView]]:
        """A run and the newest of its corrections in order; without a number of the present run, or else the last.

        Raises
        ------
        TilefabError
            If there is no such run.
        """

    def warn(self, code: str, text: str) -> None:
        """Raise an alarm that `check_warning` let through."""


def check_order(name: str, arguments: Mapping[str, object]) -> dict[str, object]:
    """Make sure that an order is one that exists, with the arguments that it takes.

    Parameters
    ----------
    name
        ``start``, ``hold``, ``resume``, ``stop``, ``ack``, ``queue``, ``reprint`` or ``settle``.
    arguments
        ``up_to`` for ``ack``: number of the newest alarm that was seen; ``job`` for ``queue``: the whole path of a job
        file; ``face`` for ``reprint`` and ``settle``; ``state`` for ``settle``: what became of it; ``run`` for both,
        if it isn't plain which job's face is meant.

    Returns
    -------
    dict
        The arguments.

    Raises
    ------
    ValueError
        If not; says what is wrong.

    >>> check_order("ack", {"up_to": 7})
    {'up_to': 7}
    """
    checks = _ORDERS.get(name)
    if checks is None:
        raise ValueError(f"there is no command {name[:40]!r}; there are {', '.join(ORDERS)}")
    for key in arguments:
        if key not in checks:
            takes = ", ".join(checks) or "nothing"
            raise ValueError(f"{name} takes no {str(key)[:40]!r}, but {takes}")
    for key, check in checks.items():
        if key not in arguments:
            if key in _OPTIONAL:
                continue
            raise ValueError(f"{name} needs {key!r}")
        problem = check(arguments[key])
        if problem:
            raise ValueError(f"{name}: {key} must be {problem}")
    return dict(arguments)


def check_correction(value: object) -> tuple[int, dict[str, object], str]:
    """Make sure that a correction is asked for as it must be; whether its drift makes sense isn't looked at.

    Parameters
    ----------
    value
        ``run_id``, ``drift`` (a drift state, as in its file) and ``reason``, and nothing else.

    Returns
    -------
    tuple
        The three.

    Raises
    ------
    ValueError
        If not; says what is wrong.
    """
    run_id, drift, reason = _given(value, {"run_id": _RUN, "drift": _table, "reason": _text})
    return run_id, drift, reason


def check_warning(value: object) -> tuple[str, str]:
    """Make sure that an alarm from outside the daemon is one that may come from there.

    Parameters
    ----------
    value
        ``code``, one of `tilefab.pipeline.line.alarms.FROM_INSPECTION`, and ``text``, and nothing else.

    Returns
    -------
    tuple
        The two.

    Raises
    ------
    ValueError
        If not; says what is wrong.

    >>> check_warning({"code": "defect_run", "text": "3 of 5 tiles show a line at 41 mm"})
    ('defect_run', '3 of 5 tiles show a line at 41 mm')
    """
    code, text = _given(value, {"code": _inspector_code, "text": _text})
    return code, text


def _given(value: object, checks: Mapping[str, Callable[[object], str]]) -> tuple[Any, ...]:
    """Values of an object that has certain keys and no others."""
    if not isinstance(value, Mapping) or set(value) != set(checks):
        raise ValueError(f"give a JSON object with {', '.join(checks)}, and nothing else")
    for key, check in checks.items():
        problem = check(value[key])
        if problem:
            raise ValueError(f"{key} must be {problem}")
    return tuple(value[key] for key in checks)


def _whole(least: int, below: int) -> Callable[[object], str]:
    def check(value: object) -> str:
        right = isinstance(value, int) and not isinstance(value, bool) and least <= value < below
        return "" if right else f"a whole number from {least} to {below - 1}"

    return check


def _path(value: object) -> str:
    right = isinstance(value, str) and value.startswith("/") and len(value) <= _LONGEST_PATH and value.isprintable()
    return "" if right else "the whole path of a job file"


def _settled(value: object) -> str:
    return "" if isinstance(value, str) and value in SETTLED else f"one of {', '.join(SETTLED)}"


def _text(value: object) -> str:
    right = isinstance(value, str) and 0 < len(value) <= _LONGEST_TEXT and value.isprintable()
    return "" if right else f"1 to {_LONGEST_TEXT} printable characters"


def _table(value: object) -> str:
    return "" if isinstance(value, dict) else "a drift state: a JSON object, as in its file"


def _inspector_code(value: object) -> str:
    return "" if isinstance(value, str) and value in FROM_INSPECTION else f"one of {', '.join(sorted(FROM_INSPECTION))}"


_FACE = _whole(0, MOST_FACES)
_RUN = _whole(1, 1 << 31)
_ORDERS: Mapping[str, Mapping[str, Callable[[object], str]]] = {
    "start": {},
    "hold": {},
    "resume": {},
    "stop": {},
    "ack": {"up_to": _whole(0, _MOST_ALARMS)},
    "queue": {"job": _path},
    "reprint": {"face": _FACE, "run": _RUN},
    "settle": {"face": _FACE, "state": _settled, "run": _RUN},
}
_OPTIONAL = frozenset({"run"})
ORDERS = tuple(_ORDERS)
"""Names of all orders."""
