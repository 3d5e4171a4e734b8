"""A line's status as a table on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import datetime

from rich import box
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from tilefab.control.ledger import ArmState
from tilefab.control.line_machine import LineState
from tilefab.pipeline.line.status import AlarmView, FaceView, LineStatus

_STYLES = {
    LineState.RUNNING: "black on green",
    LineState.ARMING: "black on cyan",
    LineState.DRAINING: "black on cyan",
    LineState.HOLDING: "black on yellow",
    LineState.E_STOPPED: "white on red",
    LineState.FAULTED: "white on red",
}
_FACE_STYLES = {
    ArmState.PASSED: "green",
    ArmState.PRINTED: "cyan",
    ArmState.DIVERTED: "yellow",
    ArmState.PARTIAL: "yellow",
    ArmState.IN_DOUBT: "bold red",
}
_LITTLE_INK = 0.1
_BAR_CELLS = 12
_WIDE = 110
_NAMED = 8
_OFF_DEGC = 5.0


def status_view(status: LineStatus, now: datetime, *, width: int = 100) -> RenderableType:
    """All that a status says, alarms first.

    Parameters
    ----------
    status
        The line's.
    now
        To tell how long ago things were; with its offset.
    width
        Of the terminal, characters.
    """
    parts: list[RenderableType] = [_head(status, now)]
    if status.alarms:
        parts.append(_alarms(status.alarms, now))
    parts.append(_panels(status, now, width))
    if status.kiln_degc:
        parts.append(_kiln(status))
    if status.last_faces:
        parts.append(_faces(status.last_faces, now, width))
    return Group(*parts)


def ago(then: str, now: datetime) -> str:
    """How long ago an ISO time was, in a few characters.

    >>> ago("2026-01-01T00:00:00+00:00", datetime.fromisoformat("2026-01-01T02:05:00+00:00"))
    '2 h 05 min'
    """
    try:
        seconds = (now - datetime.fromisoformat(then)).total_seconds()
    except (ValueError, TypeError):
        return then
    seconds = max(0, int(seconds))
    if seconds < 60:
        return f"{seconds} s"
    if seconds < 3600:
        return f"{seconds // 60} min {seconds % 60:02} s"
    if seconds < 86400:
        return f"{seconds // 3600} h {seconds % 3600 // 60:02} min"
    return f"{seconds // 86400} d {seconds % 86400 // 3600} h"


def _head(status: LineStatus, now: datetime) -> RenderableType:
    state = status.state.replace("_", "-").upper()
    text = Text.assemble(
        (f" {status.line} ", "bold"),
        (f" {state} ", _STYLES.get(_state(status.state), "reverse")),
        f" for {ago(status.since, now)}",
    )
    if status.reason:
        text.append(f": {status.reason}")
    return text


def _state(name: str) -> LineState:
    try:
        return LineState(name)
    except ValueError:
        return LineState.IDLE


def _alarms(alarms: Iterable[AlarmView], now: datetime) -> RenderableType:
    table = Table(box=box.SIMPLE_HEAD, expand=True, pad_edge=False, border_style="red")
    table.add_column("No", justify="right", no_wrap=True)
    table.add_column("alarm", no_wrap=True)
    table.add_column("for", no_wrap=True)
    table.add_column("what happened", ratio=2)
    table.add_column("what to do", ratio=3)
    for alarm in alarms:
        code = Text(alarm.code, style="dim" if alarm.acked else "bold red")
        if alarm.acked:
            code.append("\nacknowledged")
        table.add_row(
            str(alarm.number), code, ago(alarm.since, now), Text(alarm.message), Text(alarm.what_to_do), style=None
        )
    return table


def _pairs(title: str, rows: Iterable[tuple[str, str | Text]]) -> Panel:
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold", max_width=34)
    for label, value in rows:
        table.add_row(Text(label), value if isinstance(value, Text) else Text(value))
    return Panel(table, title=title, title_align="left", border_style="dim")


def _panels(status: LineStatus, now: datetime, width: int) -> RenderableType:
    job, belt, devices = _job(status, now), _belt(status), _devices(status)
    ink = [_ink(status)] if status.ink_frac else []
    if width >= _WIDE:
        columns = [[job], [belt, devices], ink]
    else:
        columns = [[job, devices], [belt, *ink]]
    grid = Table.grid(padding=(0, 1, 0, 0))
    grid.add_row(*(Group(*column) for column in columns))
    return grid


def _correction(status: LineStatus, now: datetime) -> str:
    made = status.correction
    return "none" if made is None else f"{made.number}, {ago(made.made_at, now)} ago: {made.reason}"


def _job(status: LineStatus, now: datetime) -> Panel:
    counts = status.counts
    rows: list[tuple[str, str | Text]] = [("name", status.job or "none")]
    if status.run_id is not None:
        rows.append(("run", str(status.run_id)))
        rows.append(("correction", _correction(status, now)))
        passed = counts.get(ArmState.PASSED, 0)
        share = f" ({100 * passed / status.faces_wanted:.1f} %)" if status.faces_wanted else ""
        rows.append(("passed", f"{passed:,} of {status.faces_wanted:,}{share}"))
        under_way = sum(counts.get(state, 0) for state in (ArmState.INTENT, ArmState.ARMED, ArmState.PRINTED))
        rows.append(("under way", f"{under_way:,}"))
        scrapped = counts.get(ArmState.DIVERTED, 0) + counts.get(ArmState.PARTIAL, 0)
        rows.append(("scrapped", Text(f"{scrapped:,}", style="yellow" if scrapped else "")))
    if status.in_doubt:
        runs: dict[int, list[str]] = {}
        for doubt in status.faces_in_doubt[:_NAMED]:
            runs.setdefault(doubt.run_id, []).append(f"{doubt.face:,}")
        named = "; ".join(f"run {run}: {', '.join(faces)}" for run, faces in runs.items())
        what = f"settle {named}" if status.in_doubt <= _NAMED and named else f"settle {status.in_doubt:,} faces"
        rows.append(("in doubt", Text(what, style="bold red")))
    rows.append(("then", ", ".join(status.queue) or "nothing queued"))
    return _pairs("job", rows)


def _belt(status: LineStatus) -> Panel:
    running = Text("runs", style="green") if status.belt_running else Text("stands", style="yellow")
    return _pairs(
        "belt",
        [
            ("belt", running),
            ("speed", f"{status.belt_speed_mm_s:.0f} mm/s"),
            ("faces", f"{status.faces_per_minute:.0f} a minute"),
            ("armed ahead", str(status.armed_ahead)),
        ],
    )


def _ink(status: LineStatus) -> Panel:
    names = (*status.ink_names, *(f"ink {n}" for n in range(len(status.ink_names) + 1, len(status.ink_frac) + 1)))
    return _pairs("ink", [(name, _bar(level)) for name, level in zip(names, status.ink_frac, strict=False)])


def _bar(level: float) -> Text:
    filled = round(_BAR_CELLS * min(1.0, max(0.0, level)))
    style = "red" if level < _LITTLE_INK else "green"
    return Text.assemble(("█" * filled, style), ("░" * (_BAR_CELLS - filled), "dim"), f" {100 * level:3.0f} %")


def _kiln(status: LineStatus) -> RenderableType:
    table = Table(box=None, pad_edge=False)
    table.add_column("zone", style="dim")
    for zone in range(1, len(status.kiln_degc) + 1):
        table.add_column(str(zone), justify="right", min_width=4, header_style="dim")
    wanted: Sequence[float | None] = status.kiln_set_degc or (None,) * len(status.kiln_degc)
    pairs = list(zip(status.kiln_degc, wanted, strict=False))
    off = [want is not None and abs(degc - want) > _OFF_DEGC for degc, want in pairs]
    now = (Text(f"{degc:.0f}", style="yellow" if far else "") for (degc, _), far in zip(pairs, off, strict=True))
    table.add_row("°C", *now)
    table.add_row("set", *("" if want is None else f"{want:.0f}" for _, want in pairs))
    title = f"kiln, {status.kiln_tiles:,} tiles"
    return Panel(table, title=title, title_align="left", border_style="dim", expand=False)


def _devices(status: LineStatus) -> Panel:
    rows: list[tuple[str, str | Text]] = []
    for name, device in status.devices.items():
        silent = "not there yet" if device.last_seen_s is None else f"silent for {device.last_seen_s:.1f} s"
        text = Text.assemble(("answers", "green") if device.connected else (silent, "bold red"))
        if device.errors:
            text.append(f", {device.errors:,} errors", style="dim")
        rows.append((name, text))
    return _pairs("devices", rows or [("none", "")])


def _faces(faces: Iterable[FaceView], now: datetime, width: int) -> RenderableType:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, expand=width > 0)
    table.add_column("face", justify="right")
    table.add_column("arm", justify="right")
    table.add_column("tile", justify="right")
    table.add_column("became")
    table.add_column("ago", justify="right", no_wrap=True)
    table.add_column("why", ratio=1)
    for face in faces:
        state = face.state.replace("_", " ")
        tile = "" if face.tile_seq is None else f"{face.tile_seq:,}"
        style = _FACE_STYLES.get(ArmState(face.state), "") if face.state in set(ArmState) else ""
        table.add_row(
            f"{face.face:,}", f"{face.arm_id:,}", tile, Text(state, style=style), ago(face.at, now), Text(face.reason)
        )
    return table
