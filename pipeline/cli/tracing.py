"""`fovea trace`: a span for every output of every exposure, for OpenTelemetry."""

import ipaddress
import logging
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TextIO
from urllib.parse import urlsplit

import click

from pipeline import signals
from pipeline.cli.arguments import DURATION_S, RUNNING
from pipeline.client import find as clients
from pipeline.client.tracing import Span, Tracing, inputs_of
from pipeline.errors import RunError, SettingsError
from pipeline.extras import need

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import ReadableSpan, TracerProvider
    from opentelemetry.sdk.trace.export import SpanExporter, SpanExportResult

EXPORT_TIMEOUT_S = 5


@click.command()
@click.argument("graph", required=False, type=RUNNING)
@click.option("--otlp", metavar="URL", help="A collector, such as http://127.0.0.1:4318/v1/traces.")
@click.option(
    "--save", type=click.Path(path_type=Path, dir_okay=False), help="JSON, a span a line."
)
@click.option("--duration-s", type=DURATION_S, help="End after that time.")
@click.option("--every", default=1, show_default=True, type=click.IntRange(1),
              help="Send the trace of one exposure of that many.")  # fmt: skip
def trace(
    graph: str | None, otlp: str | None, save: Path | None, duration_s: float | None, every: int
) -> None:
    """Send spans of a running graph's exposures to OpenTelemetry, until Ctrl-C or its end."""
    need("opentelemetry.sdk.trace", "fovea trace")
    client = clients.find(graph or "")
    inputs = inputs_of(client)
    with exported(client.name, otlp, save) as (provider, counted):
        sender = Sender(provider, every)
        with Tracing(client, inputs, sender.emit) as tracing:
            end_s = time.monotonic() + duration_s if duration_s else float("inf")
            with signals.Interruption() as asked:
                click.echo(f"{client.name}: {len(inputs)} outputs are traced; Ctrl-C ends it")
                over = tracing.run(lambda: not asked.asked() and time.monotonic() < end_s)
    said = [f"{client.name}: {counted.sent} spans of {sender.traces} exposures"]
    said += [f"{tracing.late} messages came too late for their trace"] if tracing.late else []
    said += [str(tracing.missed)] if sum(tracing.missed) else []
    click.echo("; ".join([*said, over] if over else said))
    if lost := sender.spans - counted.sent:
        raise RunError(f"fovea trace: {lost} of {sender.spans} spans were not taken: {counted.why}")


class Sender:
    """Turns spans with monotonic times into those of OpenTelemetry."""

    def __init__(self, provider: "TracerProvider", every: int = 1) -> None:
        self._tracer = provider.get_tracer("fovea")
        self._every = every
        self._wall_ns = time.time_ns() - time.monotonic_ns()
        self.spans = self.traces = 0

    def emit(self, spans: Sequence[Span]) -> None:
        """Send the spans of one exposure; the first of them contains the others."""
        from opentelemetry.trace import set_span_in_context

        whole, *parts = spans
        if int(whole.attributes["fovea.seq"]) % self._every:
            return
        root = self._tracer.start_span(
            whole.name, attributes=whole.attributes, start_time=whole.begin_ns + self._wall_ns
        )
        inside = set_span_in_context(root)
        for part in parts:
            self._tracer.start_span(
                part.name, inside, attributes=part.attributes,
                start_time=part.begin_ns + self._wall_ns,
            ).end(part.end_ns + self._wall_ns)  # fmt: skip
        root.end(whole.end_ns + self._wall_ns)
        self.spans += len(spans)
        self.traces += 1


class Counted:
    """What an exporter took, and why it did not take the rest."""

    def __init__(self) -> None:
        self.sent, self.why = 0, "more came at once than it takes"


@contextmanager
def exported(
    graph: str, otlp: str | None, save: Path | None
) -> Iterator[tuple["TracerProvider", Counted]]:
    """Yield a provider of spans that go to a collector or a file, one of the two."""
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import BatchSpanProcessor, ConsoleSpanExporter

    if bool(otlp) == bool(save):
        raise SettingsError("expected --otlp URL or --save FILE, one of the two")
    counted = Counted()
    with ExitStack() as stack:
        if otlp:
            exporter = collector(otlp)
        else:
            assert save is not None
            file = stack.enter_context(opened(save))
            exporter = ConsoleSpanExporter(
                out=file, formatter=lambda span: span.to_json(indent=None) + "\n"
            )
        provider = TracerProvider(
            resource=Resource.create({"service.name": f"fovea.{graph}"}), shutdown_on_exit=False
        )
        provider.add_span_processor(BatchSpanProcessor(_counting(exporter, counted)))
        stack.callback(provider.shutdown)
        yield provider, counted


@contextmanager
def opened(path: Path) -> Iterator[TextIO]:
    """Yield a new file; raises `RunError` if there is one or it cannot be written."""
    try:
        with path.open("x") as file:
            yield file
    except OSError as error:
        raise RunError(f"--save {path}: cannot be written: {error.strerror}") from error


def collector(url: str) -> "SpanExporter":
    """Return an exporter to a collector; raises `SettingsError` for an unfit URL."""
    from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter

    try:
        parts = urlsplit(url)
        host, valid = parts.hostname or "", parts.scheme in ("http", "https") and parts.port != 0
    except ValueError:
        host, valid = "", False
    if not (valid and host):
        raise SettingsError(f"--otlp: expected http(s)://HOST[:PORT]/v1/traces, got {url[:200]!r}")
    if parts.scheme == "http" and not is_loopback(host):
        raise SettingsError(f"--otlp: expected https beyond this host, got {url[:200]!r}")
    logging.getLogger("opentelemetry").setLevel(logging.CRITICAL)  # the end says what was lost
    return OTLPSpanExporter(endpoint=url, timeout=EXPORT_TIMEOUT_S)


def is_loopback(host: str) -> bool:
    """Whether a host's name or address is this host itself.

    >>> [is_loopback(name) for name in ("localhost", "127.0.0.2", "::1", "10.0.0.1", "example.org")]
    [True, True, True, False, False]
    """
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _counting(exporter: "SpanExporter", counted: Counted) -> "SpanExporter":
    """Return an exporter that counts what another one took."""
    from opentelemetry.sdk.trace.export import SpanExporter, SpanExportResult

    class Counting(SpanExporter):
        def export(self, spans: Sequence["ReadableSpan"]) -> "SpanExportResult":
            try:
                result = exporter.export(spans)
            except Exception as error:  # of a library; the next batch may pass
                counted.why = str(error)
                return SpanExportResult.FAILURE
            if result is SpanExportResult.SUCCESS:
                counted.sent += len(spans)
            else:
                counted.why = "the collector does not answer, or refuses them"
            return result

        def shutdown(self) -> None:
            exporter.shutdown()

        def force_flush(self, timeout_millis: int = 30000) -> bool:
            return exporter.force_flush(timeout_millis)

    return Counting()
