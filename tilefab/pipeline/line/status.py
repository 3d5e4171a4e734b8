"""How a line is doing, as people and programs are told: one frozen snapshot, and its JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, TypeVar

_V = TypeVar("_V")


@dataclass(frozen=True)
class DeviceView:
    """A device of the line.

    Attributes
    ----------
    connected
        Whether it answers.
    last_seen_s
        Seconds since its last sound answer; ``None`` if there was none.
    errors
        Failed requests and connections since the daemon started.
    """

    connected: bool
    last_seen_s: float | None
    errors: int


@dataclass(frozen=True)
class AlarmView:
    """An alarm that is up.

    Attributes
    ----------
    number
        Higher than that of any alarm before.
    code
        What kind it is.
    since
        When it was raised, ISO 8601 with its offset.
    message
        What happened.
    what_to_do
        About it.
    acked
        Whether an operator acknowledged it.
    """

    number: int
    code: str
    since: str
    message: str
    what_to_do: str
    acked: bool


@dataclass(frozen=True)
class FaceView:
    """One attempt to print a face.

    Attributes
    ----------
    face
        Its number.
    arm_id
        Number of the attempt, over all runs of the line.
    state
        What became of it: a `tilefab.control.ledger.ArmState`.
    at
        Since when, ISO 8601 with its offset.
    tile_seq
        Its tile, as the conveyor numbers it.
    reason
        Why, if there is something to say.
    correction
        Number of the correction that it is printed with; 0: as the job's file says.
    """

    face: int
    arm_id: int
    state: str
    at: str
    tile_seq: int | None
    reason: str = ""
    correction: int = 0


@dataclass(frozen=True)
class CorrectionView:
    """A correction of a run's colours.

    Attributes
    ----------
    number
        Which of the run's, 1 for the first.
    made_at
        When it was put down, ISO 8601 with its offset.
    reason
        Why, for people.
    press_key
        Hash of all that its map in inks depends on, but for the texture map.
    """

    number: int
    made_at: str
    reason: str
    press_key: str


@dataclass(frozen=True)
class DoubtView:
    """A face that an operator must settle.

    Attributes
    ----------
    run_id
        The run that it belongs to, not always the present one.
    face
        Its number.
    """

    run_id: int
    face: int


@dataclass(frozen=True)
class LineStatus:
    """How a line is doing.

    Attributes
    ----------
    line
        Its name.
    state, reason, since
        A `tilefab.control.line_machine.LineState`, why it holds or stands, and since when (ISO 8601 with its offset).
    job, run_id
        Name of the present job and number of its run in the journal; empty and ``None`` without one.
    faces_wanted
        Faces of the present job.
    counts
        Attempts of the present run by what became of them; see `tilefab.control.ledger.ArmState`.
    in_doubt, faces_in_doubt
        How many faces nobody knows the fate of, in all runs, and the first of them.
    correction
        What the coming faces of the present run are printed with; ``None``: as its job's file says.
    belt_running, belt_speed_mm_s
        As the conveyor tells.
    faces_per_minute
        Tiles with a face that were decided, over the last minute.
    armed_ahead
        Faces that the printer holds for tiles on their way to it.
    ink_names, ink_frac
        Of each ink, and how full it is, 0 to 1.
    kiln_degc, kiln_set_degc, kiln_tiles
        Of each zone from the entry on, degrees Celsius, and how many tiles are inside; empty and 0 without a kiln.
    devices
        By name.
    alarms
        Those that are up, oldest first.
    last_alarm
        Highest number of an alarm in ``alarms``: acknowledging up to it covers what was seen, and no more. 0: none.
    last_faces
        The latest attempts, newest first.
    queue
        Names of the jobs that come after the present one.
    version
        Of tilefab.
    """

    line: str
    state: str
    since: str
    version: str
    reason: str = ""
    job: str = ""
    run_id: int | None = None
    faces_wanted: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)
    in_doubt: int = 0
    faces_in_doubt: tuple[DoubtView, ...] = ()
    correction: CorrectionView | None = None
    belt_running: bool = False
    belt_speed_mm_s: float = 0.0
    faces_per_minute: float = 0.0
    armed_ahead: int = 0
    ink_names: tuple[str, ...] = ()
    ink_frac: tuple[float, ...] = ()
    kiln_degc: tuple[float, ...] = ()
    kiln_set_degc: tuple[float, ...] = ()
    kiln_tiles: int = 0
    devices: Mapping[str, DeviceView] = field(default_factory=dict)
    alarms: tuple[AlarmView, ...] = ()
    last_alarm: int = 0
    last_faces: tuple[FaceView, ...] = ()
    queue: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As what `json.dumps` takes."""
        return asdict(self)

    @staticmethod
    def from_json(value: object) -> LineStatus:
        """What `to_json` made, anew; keys that this version doesn't know are left out.

        Raises
        ------
        ValueError
            If a key is missing or isn't what it should be.
        """
        facts = _known(LineStatus, value)
        for key, item in (("alarms", AlarmView), ("last_faces", FaceView), ("faces_in_doubt", DoubtView)):
            facts[key] = tuple(_view(item, entry) for entry in _list(facts.get(key, ())))
        for key in ("ink_names", "ink_frac", "kiln_degc", "kiln_set_degc", "queue"):
            facts[key] = tuple(_list(facts.get(key, ())))
        if facts.get("correction") is not None:
            facts["correction"] = _view(CorrectionView, facts["correction"])
        devices = facts.get("devices", {})
        if not isinstance(devices, Mapping):
            raise ValueError(f"devices: {devices!r}")  # noqa: TRY004 - wrong data, not a wrong call
        facts["devices"] = {str(name): _view(DeviceView, entry) for name, entry in devices.items()}
        return _made(LineStatus, facts)


def _view(kind: Callable[..., _V], value: object) -> _V:
    return _made(kind, _known(kind, value))


def _known(kind: Any, value: object) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise ValueError(f"{kind.__name__}: {value!r}")  # noqa: TRY004 - wrong data, not a wrong call
    names = {item.name for item in fields(kind)}
    return {key: entry for key, entry in value.items() if key in names}


def _made(kind: Callable[..., _V], facts: Mapping[str, Any]) -> _V:
    try:
        return kind(**facts)
    except TypeError as error:
        raise ValueError(str(error)) from error


def _list(value: object) -> Sequence[Any]:
    if not isinstance(value, list | tuple):
        raise ValueError(f"{value!r} is no list")  # noqa: TRY004 - wrong data, not a wrong call
    return value
