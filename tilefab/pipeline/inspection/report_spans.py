"""What of a line's notes goes over time: stops, alarms, the kiln, shifts, shade lots."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

import numpy as np

from tilefab.colour import delta_e_2000, srgb_from_xyz, xyz_from_lab
from tilefab.io.inspection_records import InspectionAlarm, InspectionRecord
from tilefab.io.journal import NoteRecord
from tilefab.report.line_view import KilnZoneView, LotView, ShiftView, SpanView
from tilefab.report.view_model import Rgb

_SHIFT_STARTS_H = (6, 14, 22)
_SHIFT_H = 8
_RUNNING, _AT_REST = "running", frozenset({"idle", "stopped"})
_STATE, _ALARM, _KILN = "state", "alarm", "kiln"


def stops(notes: Sequence[NoteRecord], ended_s: float) -> tuple[SpanView, ...]:
    """Times in which a line that had begun to run did not, until it ran again or came to rest in order."""
    found: list[SpanView] = []
    since: tuple[float, str, str] | None = None
    for note in notes:
        if note.kind != _STATE:
            continue
        at, state, before = note.at.timestamp(), str(note.detail.get("state")), str(note.detail.get("before"))
        if since is not None and (state == _RUNNING or state in _AT_REST):
            found.append(SpanView(since[0], at, since[1], since[2]))
            since = None
        elif since is None and before == _RUNNING and state not in _AT_REST and state != "draining":
            since = at, state, str(note.detail.get("reason") or "no reason was given")
    if since is not None:
        found.append(SpanView(since[0], ended_s if ended_s > since[0] else None, since[1], since[2]))
    return tuple(found)


def line_alarms(notes: Sequence[NoteRecord]) -> tuple[SpanView, ...]:
    """Alarms of the daemon: it tells when they came, not when what they are about was over."""
    return tuple(
        SpanView(note.at.timestamp(), note.at.timestamp(), str(note.detail.get("code")), str(note.detail.get("text")))
        for note in notes
        if note.kind == _ALARM
    )


def inspector_alarms(alarms: Sequence[InspectionAlarm]) -> tuple[SpanView, ...]:
    """Alarms of the inspector, with their ends."""
    return tuple(
        SpanView(
            alarm.raised_at.timestamp(),
            None if alarm.cleared_at is None else alarm.cleared_at.timestamp(),
            alarm.code,
            alarm.text,
        )
        for alarm in alarms
    )


def kiln_zones(notes: Sequence[NoteRecord]) -> tuple[KilnZoneView, ...]:
    """The kiln's zones over time, from the notes that its loop puts down."""
    told = [note for note in notes if note.kind == _KILN]
    if not told:
        return ()
    at_s = tuple(note.at.timestamp() for note in told)
    degc = [_numbers(note.detail.get("temperatures_degc")) for note in told]
    wanted = _numbers(told[-1].detail.get("set_points_degc"))
    zones = min(len(row) for row in degc)
    return tuple(
        KilnZoneView(
            f"zone {zone + 1}",
            at_s,
            tuple(row[zone] for row in degc),
            wanted[zone] if zone < len(wanted) else None,
        )
        for zone in range(zones)
    )


def _numbers(value: object) -> list[float]:
    return [float(number) for number in value] if isinstance(value, list | tuple) else []


def shifts(begun_s: float, ended_s: float, utc_offset: timedelta) -> tuple[ShiftView, ...]:
    """The shifts that a run went through, by the factory's clock; none if it stayed within one."""
    local = datetime.fromtimestamp(begun_s, UTC) + utc_offset
    day = local.replace(hour=0, minute=0, second=0, microsecond=0) - timedelta(days=1)
    starts = [day + timedelta(days=number, hours=hour) for number in range(3) for hour in _SHIFT_STARTS_H]
    at = max(start for start in starts if start <= local)
    found = []
    while (at - utc_offset).timestamp() < ended_s:
        begun = (at - utc_offset).timestamp()
        found.append(ShiftView(at.strftime("%a %d %b, %H:%M"), begun, begun + _SHIFT_H * 3600.0))
        at += timedelta(hours=_SHIFT_H)
    return tuple(found) if len(found) > 1 else ()


def shade_lots(tiles: Sequence[InspectionRecord]) -> tuple[LotView, ...]:
    """Shade lots of some tiles, by name."""
    members: dict[str, list[InspectionRecord]] = defaultdict(list)
    for tile in tiles:
        if tile.shade_lot and tile.colour is not None:
            members[tile.shade_lot].append(tile)
    return tuple(_lot(name, members[name]) for name in sorted(members, key=lambda name: (len(name), name)))


def _lot(name: str, tiles: Sequence[InspectionRecord]) -> LotView:
    predicted = np.array([tile.colour.predicted_lab for tile in tiles if tile.colour is not None])
    off = np.array([tile.colour.fired_lab for tile in tiles if tile.colour is not None]) - predicted
    job, mean = predicted.mean(axis=0), off.mean(axis=0)
    spread = float(np.max(delta_e_2000(job + off, job + mean)))
    taken = [tile.taken_at.timestamp() for tile in tiles]
    red, green, blue = np.rint(np.clip(srgb_from_xyz(xyz_from_lab(job + mean)), 0.0, 1.0) * 255).astype(int)
    rgb: Rgb = int(red), int(green), int(blue)
    difference = float(mean[0]), float(mean[1]), float(mean[2])
    return LotView(name, len(tiles), difference, spread, min(taken), max(taken), rgb)
