"""`GET /metrics` for Prometheus: what the parts have counted, gathered when it is asked for."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from server.counters import LATENCIES_S, Histogram

if TYPE_CHECKING:
    from server.web.dependencies import Parts

MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class RequestCounts:
    """Times of answered requests, by method, route and class of status."""

    def __init__(self) -> None:
        self.latencies_s: dict[tuple[str, str, int], Histogram] = {}

    def observe(self, method: str, route: str, status: int, took_s: float) -> None:
        """Count an answer."""
        key = (method, route, status // 100)
        histogram = self.latencies_s.get(key)
        if histogram is None:
            histogram = self.latencies_s[key] = Histogram(LATENCIES_S)
        histogram.observe(took_s)


class Metrics:
    """Everything that one application counts."""

    def __init__(self, parts: Parts, requests: RequestCounts) -> None:
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(_Gathered(parts, requests))
        ProcessCollector(registry=self._registry)

    def text(self) -> bytes:
        """The exposition, in Prometheus's text format 0.0.4."""
        return generate_latest(self._registry)


class _Gathered(Collector):
    def __init__(self, parts: Parts, requests: RequestCounts) -> None:
        self._parts, self._requests = parts, requests

    def collect(self) -> Iterator[Metric]:
        """All families, as they are now."""
        yield _latencies(self._requests)
        yield from _of_ingest(self._parts)
        yield from _of_nearby(self._parts)
        yield from _of_push(self._parts)
        yield _counters("refused", "Requests refused by a limit.", "limit", self._parts.admission.refused)
        in_use, idle = self._parts.database.connections
        yield _gauges("database_connections", "Connections to the database.", "use", {"busy": in_use, "idle": idle})


def _of_ingest(parts: Parts) -> Iterator[Metric]:
    ingest = parts.service.ingest
    counts = ingest.counts
    yield _counters("reports", "Reports answered.", "status", counts.reports)
    yield _counters("decisions", "Decisions on detections.", "decision", counts.decisions)
    yield _counters("inspections", "Inspections of known obstacles.", "effect", counts.inspections)
    yield _counter("ingest_retries", "Transactions that were tried again.", counts.attempts_failed)
    yield _gauge("ingest_backlog", "Reports that wait for a transaction.", ingest.backlog)
    sizes = HistogramMetricFamily("headsup_ingest_group", "Reports that shared a commit.")
    sizes.add_metric([], _buckets(counts.groups), counts.groups.total)
    yield sizes


def _of_nearby(parts: Parts) -> Iterator[Metric]:
    nearby = parts.nearby
    counts = nearby.counts
    yield _counter("nearby_queries", "Nearby queries from memory.", counts.queries)
    yield _counter("nearby_version_checks", "Statements that asked for versions of tiles.", counts.version_checks)
    tiles = {"fresh": counts.tiles_fresh, "changed": counts.tiles_changed, "loaded": counts.tiles_loaded}
    yield _counters("nearby_tiles", "Tiles that queries needed, by what had to be read.", "found", tiles)
    yield _gauge("nearby_cache_bytes", "Memory of the tiles.", nearby.size_bytes)


def _of_push(parts: Parts) -> Iterator[Metric]:
    counts = parts.hub.counts
    yield _gauge("websockets", "Open WebSockets.", parts.admission.sockets)
    yield _counters("events", "Events published after a commit.", "what", counts.published)
    yield _counter("messages_sent", "Messages sent on WebSockets.", counts.sent)


def _latencies(requests: RequestCounts) -> Metric:
    labels = ["method", "route", "status"]
    family = HistogramMetricFamily("headsup_request_seconds", "Time to answer a request.", labels=labels)
    for (method, route, status_class), histogram in requests.latencies_s.items():
        family.add_metric([method, route, f"{status_class}xx"], _buckets(histogram), histogram.total)
    return family


def _buckets(histogram: Histogram) -> list[tuple[str, float]]:
    bounds = [*map(str, histogram.bounds), "+Inf"]
    return list(zip(bounds, itertools.accumulate(histogram.counts), strict=True))


def _counters(name: str, about: str, label: str, values: Mapping[str, int]) -> Metric:
    family = CounterMetricFamily(f"headsup_{name}", about, labels=[label])
    return _filled(family, values.items())


def _gauges(name: str, about: str, label: str, values: Mapping[str, int]) -> Metric:
    family = GaugeMetricFamily(f"headsup_{name}", about, labels=[label])
    return _filled(family, values.items())


def _filled(family: CounterMetricFamily | GaugeMetricFamily, values: Iterable[tuple[str, int]]) -> Metric:
    for value, number in sorted(values):
        family.add_metric([value], number)
    return family


def _counter(name: str, about: str, value: int) -> Metric:
    return CounterMetricFamily(f"headsup_{name}", about, value=value)


def _gauge(name: str, about: str, value: int) -> Metric:
    return GaugeMetricFamily(f"headsup_{name}", about, value=value)
