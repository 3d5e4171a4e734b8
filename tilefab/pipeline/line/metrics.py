"""What Prometheus is told of a line, made anew from a snapshot at each scrape."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric

from tilefab.control.ledger import ArmState
from tilefab.control.line_machine import LineState
from tilefab.pipeline.line.status import LineStatus
from tilefab.pipeline.line.timing import Latencies

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
"""Of what `metrics_text` makes."""

_QUANTILES = (0.5, 0.9, 0.99, 0.999)


@dataclass(frozen=True)
class LineCounters:
    """What is counted from the daemon's start.

    Attributes
    ----------
    tiles_passed, tiles_diverted
        Tiles with a whole face that went to the kiln, and to scrap.
    blank_tiles
        Tiles that got no face while the line printed.
    alarms
        Alarms raised.
    started_s
        When the daemon started, seconds since 1970.
    latencies
        Times by what they are of, such as ``arming``: from hearing of a tile to the printer's acceptance of its face.
    """

    tiles_passed: int = 0
    tiles_diverted: int = 0
    blank_tiles: int = 0
    alarms: int = 0
    started_s: float = 0.0
    latencies: Mapping[str, Latencies] = field(default_factory=dict)


def metrics_text(status: LineStatus, counters: LineCounters) -> bytes:
    """Metrics of a line in Prometheus' text format."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Snapshot(status, counters))
    return generate_latest(registry)


class _Snapshot:
    """Implements Prometheus' collector."""

    def __init__(self, status: LineStatus, counters: LineCounters) -> None:
        self._status, self._counters = status, counters

    def describe(self) -> list[Metric]:
        """Nothing: names are known only once collected."""
        return []

    def collect(self) -> Iterator[Metric]:
        """All metrics."""
        yield from self._line()
        yield from self._faces()
        yield from self._devices()
        yield from self._times()

    def _line(self) -> Iterator[Metric]:
        status, counters = self._status, self._counters
        yield self._labelled(
            "tilefab_line_info",
            "Line, version of tilefab, present job.",
            ("version", "job"),
            {(status.version, status.job): 1.0},
        )
        states = {(state.value,): float(state.value == status.state) for state in LineState}
        yield self._labelled("tilefab_line_state", "1 for the state that the line is in.", ("state",), states)
        unacked = sum(not alarm.acked for alarm in status.alarms)
        yield self._gauge("tilefab_line_alarms", "Alarms that are up.", len(status.alarms))
        yield self._gauge("tilefab_line_alarms_unacked", "Alarms that nobody acknowledged.", unacked)
        yield self._counter("tilefab_line_alarms_raised", "Alarms raised.", counters.alarms)
        yield self._gauge("tilefab_line_start_time_seconds", "When the daemon started.", counters.started_s)
        yield self._gauge("tilefab_line_queued_jobs", "Jobs that come after the present one.", len(status.queue))

    def _faces(self) -> Iterator[Metric]:
        status, counters = self._status, self._counters
        yield self._gauge("tilefab_line_faces_wanted", "Faces of the present job.", status.faces_wanted)
        counts = {(state.value,): float(status.counts.get(state.value, 0)) for state in ArmState}
        yield self._labelled(
            "tilefab_line_arms",
            "Attempts to print a face of the present run, by what became of them.",
            ("state",),
            counts,
        )
        yield self._gauge("tilefab_line_faces_in_doubt", "Faces that an operator must settle.", status.in_doubt)
        yield self._gauge("tilefab_line_faces_per_minute", "Over the last minute.", status.faces_per_minute)
        yield self._gauge(
            "tilefab_line_armed_ahead", "Faces that the printer holds for coming tiles.", status.armed_ahead
        )
        yield self._counter("tilefab_line_tiles_passed", "Tiles sent to the kiln.", counters.tiles_passed)
        yield self._counter("tilefab_line_tiles_diverted", "Whole faces sent to scrap.", counters.tiles_diverted)
        yield self._counter("tilefab_line_tiles_blank", "Tiles that got no face in time.", counters.blank_tiles)

    def _devices(self) -> Iterator[Metric]:
        status = self._status
        yield self._gauge("tilefab_line_belt_running", "Whether the belt runs.", float(status.belt_running))
        yield self._gauge("tilefab_line_belt_speed_mm_per_second", "Of the belt.", status.belt_speed_mm_s)
        names = status.ink_names if len(status.ink_names) == len(status.ink_frac) else ()
        inks = {(str(channel), names[channel] if names else ""): level for channel, level in enumerate(status.ink_frac)}
        yield self._labelled("tilefab_line_ink_ratio", "How full an ink is, 0 to 1.", ("channel", "ink"), inks)
        for name, what, zones in (
            ("tilefab_line_kiln_celsius", "Temperature of a zone.", status.kiln_degc),
            ("tilefab_line_kiln_set_celsius", "Set-point of a zone.", status.kiln_set_degc),
        ):
            yield self._labelled(name, what, ("zone",), {(str(n),): degc for n, degc in enumerate(zones, start=1)})
        yield self._gauge("tilefab_line_kiln_tiles", "Tiles in the kiln.", status.kiln_tiles)
        devices = status.devices.items()
        yield self._labelled(
            "tilefab_line_device_up",
            "Whether a device answers.",
            ("device",),
            {(n,): float(d.connected) for n, d in devices},
        )
        yield self._labelled(
            "tilefab_line_device_silence_seconds",
            "Time since a device's last sound answer.",
            ("device",),
            {(n,): d.last_seen_s for n, d in devices if d.last_seen_s is not None},
        )
        errors = CounterMetricFamily(
            "tilefab_line_device_errors", "Failed requests and connections.", labels=("line", "device")
        )
        for name, device in devices:
            errors.add_metric((status.line, name), device.errors)
        yield errors

    def _times(self) -> Iterator[Metric]:
        for name, times in sorted(self._counters.latencies.items()):
            quantiles = {(str(share),): times.quantile_s(share) for share in _QUANTILES} | {("1",): times.largest_s}
            yield self._labelled(f"tilefab_line_{name}_seconds", f"Quantiles of {name}.", ("quantile",), quantiles)
            yield self._counter(f"tilefab_line_{name}_times", f"How often {name} was timed.", times.count)

    def _gauge(self, name: str, what: str, value: float) -> Metric:
        return self._labelled(name, what, (), {(): value})

    def _labelled(
        self, name: str, what: str, labels: tuple[str, ...], values: Mapping[tuple[str, ...], float]
    ) -> Metric:
        family = GaugeMetricFamily(name, what, labels=("line", *labels))
        for key, value in values.items():
            family.add_metric((self._status.line, *key), value)
        return family

    def _counter(self, name: str, what: str, value: float) -> Metric:
        family = CounterMetricFamily(name, what, labels=("line",))
        family.add_metric((self._status.line,), value)
        return family
