"""What Prometheus is told of a line, made anew from a snapshot at each scrape."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
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
_Labels = tuple[str, ...]
_Values = Iterable[tuple[_Labels, float]]


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
        info = ((status.version, status.job), 1.0)
        yield self._labelled("info", "Version of tilefab and present job.", ("version", "job"), [info])
        states = [((state.value,), float(state.value == status.state)) for state in LineState]
        yield self._labelled("state", "1 for the state that the line is in.", ("state",), states)
        unacked = sum(not alarm.acked for alarm in status.alarms)
        yield self._gauge("alarms", "Alarms that are up.", len(status.alarms))
        yield self._gauge("alarms_unacked", "Alarms that nobody acknowledged.", unacked)
        yield self._counter("alarms_raised", "Alarms raised.", counters.alarms)
        yield self._gauge("start_time_seconds", "When the daemon started.", counters.started_s)
        correction = status.correction.number if status.correction is not None else 0
        yield self._gauge("correction", "Number of the correction in use, 0: as the job's file says.", correction)
        yield self._gauge("queued_jobs", "Jobs that come after the present one.", len(status.queue))

    def _faces(self) -> Iterator[Metric]:
        status, counters = self._status, self._counters
        yield self._gauge("faces_wanted", "Faces of the present job.", status.faces_wanted)
        arms = [((state.value,), float(status.counts.get(state.value, 0))) for state in ArmState]
        yield self._labelled("arms", "Attempts at faces of the present run, by what became of them.", ("state",), arms)
        yield self._gauge("faces_in_doubt", "Faces that an operator must settle.", status.in_doubt)
        yield self._gauge("faces_per_minute", "Over the last minute.", status.faces_per_minute)
        yield self._gauge("armed_ahead", "Faces that the printer holds for coming tiles.", status.armed_ahead)
        yield self._counter("tiles_passed", "Tiles with a whole face, sent to the kiln.", counters.tiles_passed)
        yield self._counter("tiles_diverted", "Tiles with a whole face, sent to scrap.", counters.tiles_diverted)
        yield self._counter("tiles_blank", "Tiles that got no face while the line printed.", counters.blank_tiles)

    def _devices(self) -> Iterator[Metric]:
        status = self._status
        yield self._gauge("belt_running", "Whether the belt runs.", float(status.belt_running))
        yield self._gauge("belt_speed_mm_per_second", "Of the belt.", status.belt_speed_mm_s)
        names = (*status.ink_names, *("" for _ in status.ink_frac))
        inks = [((str(channel), names[channel]), level) for channel, level in enumerate(status.ink_frac)]
        yield self._labelled("ink_ratio", "How full an ink is, 0 to 1.", ("channel", "ink"), inks)
        for name, what, zones in (
            ("kiln_celsius", "Temperature of a zone.", status.kiln_degc),
            ("kiln_set_celsius", "Set-point of a zone.", status.kiln_set_degc),
        ):
            yield self._labelled(name, what, ("zone",), [((str(n),), degc) for n, degc in enumerate(zones, start=1)])
        yield self._gauge("kiln_tiles", "Tiles in the kiln.", status.kiln_tiles)
        devices = status.devices.items()
        up = [((name,), float(device.connected)) for name, device in devices]
        yield self._labelled("device_up", "Whether a device answers.", ("device",), up)
        silent = [((name,), device.last_seen_s) for name, device in devices if device.last_seen_s is not None]
        yield self._labelled("device_silence_seconds", "Since the last sound answer.", ("device",), silent)
        errors = [((name,), float(device.errors)) for name, device in devices]
        yield self._counted("device_errors", "Failed requests and connections.", ("device",), errors)

    def _times(self) -> Iterator[Metric]:
        for name, times in sorted(self._counters.latencies.items()):
            quantiles = [((str(share),), times.quantile_s(share)) for share in _QUANTILES]
            quantiles.append((("1",), times.largest_s))
            yield self._labelled(f"{name}_seconds", f"Quantiles of {name}.", ("quantile",), quantiles)
            yield self._counter(f"{name}_times", f"How often {name} was timed.", times.count)

    def _gauge(self, name: str, what: str, value: float) -> Metric:
        return self._labelled(name, what, (), [((), value)])

    def _counter(self, name: str, what: str, value: float) -> Metric:
        return self._counted(name, what, (), [((), value)])

    def _labelled(self, name: str, what: str, labels: _Labels, values: _Values) -> Metric:
        family = GaugeMetricFamily(f"tilefab_line_{name}", what, labels=("line", *labels))
        for key, value in values:
            family.add_metric((self._status.line, *key), value)
        return family

    def _counted(self, name: str, what: str, labels: _Labels, values: _Values) -> Metric:
        family = CounterMetricFamily(f"tilefab_line_{name}", what, labels=("line", *labels))
        for key, value in values:
            family.add_metric((self._status.line, *key), value)
        return family
