"""What the inspector remembers over a restart: of a press how it drifts, of a run what its tiles showed."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from tilefab.control.drift_control import control_from_record, control_record
from tilefab.control.drift_control_state import ControlSettings, DriftControl
from tilefab.inspection.records import Lab
from tilefab.inspection.shade import ShadeState
from tilefab.inspection.watch import WatchState

SCHEMA_VERSION = 1

_T = TypeVar("_T")


@dataclass(frozen=True)
class ChartState:
    """Where the control charts of one value stand.

    Attributes
    ----------
    watch
        The charts.
    signals
        Of each chart and side (``ewma+``, ``cusum-``) the number of the value that made its latest signal.
    """

    watch: WatchState = field(default_factory=WatchState)
    signals: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PressState:
    """How a press drifts: one for all runs printed on it.

    Attributes
    ----------
    control
        The drift controller. It knows corrections by numbers of all runs, see `tilefab.pipeline.inspection.correcting`.
    charts
        Of what tiles say of L*, a* and b*.
    """

    control: DriftControl
    charts: tuple[ChartState, ChartState, ChartState] = (ChartState(), ChartState(), ChartState())

    def text(self) -> str:
        """As JSON."""
        charts = [{"watch": chart.watch.plain(), "signals": dict(chart.signals)} for chart in self.charts]
        return _text({"control": control_record(self.control), "charts": charts})


@dataclass(frozen=True)
class RunState:
    """What the tiles of a run showed.

    Attributes
    ----------
    shade
        Shade lots so far.
    reference_lab
        Colour about which shades are judged: that of the run's first tile; ``None`` before it.
    defects
        Of the latest tiles, the newest last: kinds of defects that may come again, each with its place across the
        tile (mm) where that means something.
    """

    shade: ShadeState = field(default_factory=ShadeState)
    reference_lab: Lab | None = None
    defects: tuple[tuple[tuple[str, float], ...], ...] = ()

    def text(self) -> str:
        """As JSON."""
        return _text(
            {
                "shade": self.shade.plain(),
                "reference_lab": self.reference_lab,
                "defects": self.defects,
            }
        )


def press_name(press: str) -> str:
    """What a press is remembered as."""
    return f"press {press}"


def run_name(run_id: int) -> str:
    """What a run is remembered as."""
    return f"run {run_id}"


def press_state(text: str, settings: ControlSettings) -> PressState:
    """What `PressState.text` wrote, with these settings of the controller from now on.

    Raises
    ------
    ValueError
        If it is of another version, or none.
    """

    def read(plain: Mapping[str, Any]) -> PressState:
        first, second, third = (
            ChartState(
                WatchState.from_plain(chart["watch"]),
                {str(name): int(at) for name, at in chart["signals"].items()},
            )
            for chart in plain["charts"]
        )
        return PressState(control_from_record(plain["control"], settings), (first, second, third))

    return _read(text, read)


def run_state(text: str) -> RunState:
    """What `RunState.text` wrote.

    Raises
    ------
    ValueError
        If it is of another version, or none.
    """

    def read(plain: Mapping[str, Any]) -> RunState:
        reference = plain["reference_lab"]
        return RunState(
            ShadeState.from_plain(plain["shade"]),
            None if reference is None else (float(reference[0]), float(reference[1]), float(reference[2])),
            tuple(tuple((str(kind), float(place)) for kind, place in found) for found in plain["defects"]),
        )

    return _read(text, read)


def _text(plain: Mapping[str, Any]) -> str:
    return json.dumps({"schema_version": SCHEMA_VERSION, **plain}, separators=(",", ":"))


def _read(text: str, read: Callable[[Mapping[str, Any]], _T]) -> _T:
    try:
        plain = json.loads(text)
        if plain["schema_version"] != SCHEMA_VERSION:
            raise ValueError(f"schema_version {plain['schema_version']!r:.20}, not {SCHEMA_VERSION}")
        return read(plain)
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"nothing that was remembered: {error!r}") from error
