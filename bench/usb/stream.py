"""The paper's two streams over the USB driver and through a whole graph: `python -m bench.usb`.

2040x1148 and 4080x2296 raw pixels of a 16320x9184 sensor at 30 Hz, from a virtual board over pyusb
(a backend of it, not a kernel). Reports frames dropped by reason, whether a message's pixels are
the very memory that the transfer wrote, processor time and bytes of each stage, and exposure ->
command. What the board itself costs is counted apart: its pictures are prepared (`bench.usb.ring`),
what it copies stands for the host controller's work, and its link takes the time that 400 MB/s
take, `--reads` of them in flight (`bench.usb.paced`).
"""

import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import click
import psutil

from bench.machine import LIBRARIES, facts
from bench.options import JSON, ROOT, Bench, file_name
from bench.results.markdown import table_of
from bench.run_time import PAPER_MS, TOTAL
from bench.usb.backend import RingSettings
from drivers.usb.capabilities import BoardCapabilities
from pipeline.errors import RunError
from pipeline.file_arguments import GRAPH_FILE
from pipeline.graph.editing import with_nodes
from pipeline.graph.loader import load
from pipeline.graph.overlay import Overlay
from pipeline.graph.plan import Plan
from pipeline.pixel_formats import FORMATS, PixelFormat
from pipeline.run.loaded_graph import account_of
from pipeline.run.report import Report
from pipeline.run.supervisor import Supervisor

BOARD, WITNESS = ROOT / "bench/usb_board.yaml", ROOT / "bench/usb_witness.yaml"
WANTED_HZ = 30.0
PAPER_LIVE_HZ, PAPER_DELAY_FRAMES = 7.5, 60  # of its board; the delay includes read-out
SENDERS = {"context": "capture", "roi": "capture", "small": "downsample"}  # else their namesakes
SINGLE = ("achieved_hz", "cores_used", "cores_busy_percent")
NESTED = ("frames", "copies", "loop_ms", "commands", "board")
TABLES = ("beside_the_paper", "stages", "edges")
Frames = Sequence[Sequence[Any]]  # stream, seq, place, bytes


class Usage(NamedTuple):
    """Processor time while frames were exposed."""

    spent_s: Mapping[str, float]  # by process
    elapsed_s: float
    busy_percent: float  # of all cores of the machine, whatever ran there


@click.command(cls=Bench, help=__doc__)
@click.argument("graph", default="tracking", type=GRAPH_FILE)
@click.option("--seconds", default=60.0, show_default=True, type=click.FloatRange(2, 3600))
@click.option("--bits", default="8", show_default=True, type=click.Choice(["8", "16"]))
@click.option("--rate-hz", default=0.0, help="0: 30, or the most that the link carries.")
@click.option("--cores", default=2, show_default=True, type=click.IntRange(1), help="At most.")
@click.option("--reads", default=16, show_default=True, help="In flight, as the link is modelled.")
@click.option("--ring", default=4, show_default=True, help="Pictures of the virtual sensor.")
@click.option("--size", nargs=2, type=int, default=(0, 0), help="Of the sensor; 0: the paper's.")
@click.option("--seed", default=7, show_default=True, help="Of the pictures.")
@click.option("--set", "changes", multiple=True, metavar="NODE.SETTING=VALUE")
@JSON
def main(
    graph: Path, seconds: float, bits: str, rate_hz: float, cores: int, reads: int, ring: int,
    size: tuple[int, int], seed: int, changes: tuple[str, ...], path: Path | None,
) -> None:  # fmt: skip
    """Run the graph once and report."""
    form = FORMATS[f"bayer_rggb{bits}"]
    settings = RingSettings(ring=ring, reads=reads, seed=seed, size_px=size)
    can = settings.scaled().can
    rate_hz = rate_hz or rate_of(can, form)
    with on_cores(cores) as used, tempfile.TemporaryDirectory() as folder:
        logs = Path(folder) / "board.json", Path(folder) / "witness.json"
        plan = plan_of(graph, changes, settings, form, rate_hz, logs)
        report, usage = run(plan, seconds)
        board, seen = (json.loads(log.read_text()) for log in logs)
    result = {
        "bench": "usb", **facts((*LIBRARIES, "pyusb")), "graph": file_name(graph), "seed": seed,
        "format": form.name, "rate_hz": rate_hz, "cores_used": used,
        "reads_in_flight": reads, "changes": list(changes),
        "frame_bytes": frame_bytes(can, form), **summarise(report, board, seen, usage, plan),
    }  # fmt: skip
    show(result)
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1) + "\n")


def rate_of(can: BoardCapabilities, form: PixelFormat, wanted_hz: float = WANTED_HZ) -> float:
    """Return the rate that the link allows in this format, in whole millihertz."""
    limit = can.link_bytes_per_s / frame_bytes(can, form) if can.link_bytes_per_s else wanted_hz
    return min(wanted_hz, int(limit * 1000) / 1000, can.rates_mhz[1] / 1000)


def frame_bytes(can: BoardCapabilities, form: PixelFormat) -> int:
    """Return the bytes of both pictures of one exposure; the ROI has the board's first size."""
    roi = can.roi_sizes[0]
    pictures = (can.context_px, (roi.width_px, roi.height_px))
    return sum(form.row_bytes(width) * height for width, height in pictures)


@contextmanager
def on_cores(most: int) -> Iterator[int]:
    """Keep to the first cores, as processes started meanwhile do; yields how many there are."""
    allowed = os.sched_getaffinity(0)
    used = sorted(allowed)[:most]
    os.sched_setaffinity(0, used)
    try:
        yield len(used)
    finally:
        os.sched_setaffinity(0, allowed)


def plan_of(
    graph: Path, changes: Iterable[str], settings: RingSettings, form: PixelFormat,
    rate_hz: float, logs: tuple[Path, Path],
) -> Plan:  # fmt: skip
    """Return the graph over the board, with the witness."""
    roi = settings.scaled().can.roi_sizes[0]
    options: dict[str, Any] = {
        "ring": settings.ring, "reads": settings.reads, "seed": settings.seed,
        "size_px": list(settings.size_px), "log": str(logs[0]),
    }  # fmt: skip
    values: list[tuple[str, str, Any]] = [
        ("capture", "options.pixel_format", form.name),
        ("capture", "options.rate_hz", rate_hz),
        ("capture", "options.roi_px", [roi.width_px, roi.height_px]),
        *(("capture", f"options.backend_options.{k}", value) for k, value in options.items()),
    ]
    overlay = Overlay(
        source=BOARD, changes=tuple(changes), clock="realtime", values=tuple(values)
    )  # fmt: skip
    found = with_nodes(load(graph, overlay), WITNESS)
    nodes = (
        replace(n, settings={"log": str(logs[1])}) if n.name == "witness" else n
        for n in found.nodes
    )
    return replace(found, name=f"{found.name}-usb", nodes=tuple(nodes))


def run(plan: Plan, seconds: float) -> tuple[Report, Usage]:
    """Run a plan; return its report, and the processor time while frames were exposed."""
    with Supervisor(plan) as supervisor:
        supervisor.start()
        before = processor_s(supervisor)
        psutil.cpu_percent()  # the first call begins to count
        while not supervisor.finished and supervisor.exposed_s < seconds:
            supervisor.tick()
        elapsed_s, busy_percent = supervisor.exposed_s, psutil.cpu_percent()
        spent = {name: s - before.get(name, 0.0) for name, s in processor_s(supervisor).items()}
        if supervisor.begun:
            supervisor.finish()
        supervisor.stop()
        if supervisor.failure:
            raise RunError(supervisor.failure)
        return account_of(supervisor, elapsed_s), Usage(spent, elapsed_s, busy_percent)


def processor_s(supervisor: Supervisor) -> dict[str, float]:
    """Return the processor time of each process since it was started."""
    found = {}
    for name in supervisor.plan.processes():
        try:
            times = psutil.Process(supervisor.pid(name)).cpu_times()
        except psutil.NoSuchProcess:
            continue
        found[name] = times.user + times.system
    return found


def summarise(
    report: Report, board: Mapping[str, Any], seen: Frames, usage: Usage, plan: Plan,
) -> dict[str, Any]:  # fmt: skip
    """Return the figures; lists are tables."""
    copied = copies(by_frame(board["frames"]), by_frame(seen))
    return {
        "beside_the_paper": beside_the_paper(report, copied),
        "achieved_hz": report["rate"]["achieved_hz"],
        "frames": drops(report, board["frames"]),
        "copies": copied,
        "loop_ms": {share: report["loop"]["latency_ms"][share] for share in ("p50", "p99")},
        "commands": dict(report["commands"]),
        "board": board["board"],
        "cores_busy_percent": usage.busy_percent,
        "restarts": sum(report["restarts"].values()),
        "stages": stages(report, seen, usage, plan),
        "edges": [
            {"from": e["from"], "to": e["to"], "offered": e["offered"],
             "delivered": e["delivered"],
             "dropped": ", ".join(f"{why} {n}" for why, n in e["dropped"].items()) or "0"}
            for e in report["edges"] if not e["to"].startswith("witness.")
        ],
    }  # fmt: skip


def drops(report: Report, written: Frames) -> dict[str, int]:
    """Return what became of the exposures, by the reasons that the driver counted.

    Those before the first that was delivered were exposed while the graph still started. What no
    reason explains is `unexplained`; an exposure can have two reasons.
    """
    frames, reasons = report["frames"], report["losses"]
    before = min((seq for _, seq, _, _ in written), default=0)
    return {
        "delivered": frames["exposed"], "before_the_first": before,
        "dropped": frames["lost"] + frames["overrun"], "lost": frames["lost"],
        "overrun": frames["overrun"],
        **{f"reason_{name}": count for name, count in reasons.items()},
        "unexplained": max(0, frames["lost"] + before - sum(reasons.values())),
    }  # fmt: skip


def beside_the_paper(report: Report, copied: Mapping[str, int]) -> list[dict[str, Any]]:
    """Return the figures that the paper has, too; None: it says nothing of it.

    The paper's are of its real board, these of a virtual one.
    """
    hz, latency_ms = report["rate"]["achieved_hz"], report["loop"]["latency_ms"]
    frames = report["frames"]
    rows: list[tuple[str, Any, Any]] = [
        ("exposures a second that reach the host live, Hz", hz, PAPER_LIVE_HZ),
        ("exposure -> command accepted, ms p50", latency_ms["p50"], PAPER_MS[TOTAL]),
        ("exposure -> command accepted, ms p99", latency_ms["p99"], None),
        (
            "the same in frames, p50; the paper's with read-out",
            round(latency_ms["p50"] * hz / 1000, 2),
            PAPER_DELAY_FRAMES,
        ),
        ("frames dropped", frames["lost"] + frames["overrun"], None),
        ("frames copied after the read", copied["copied"], None),
    ]
    return [
        {"figure": name, "here, virtual board": here, "the paper's board": paper}
        for name, here, paper in rows
    ]


def by_frame(frames: Frames) -> dict[tuple[str, int], tuple[str, int]]:
    """Return place and bytes by stream and seq."""
    return {(stream, seq): (place, count) for stream, seq, place, count in frames}


def copies(
    written: Mapping[tuple[str, int], tuple[str, int]],
    arrived: Mapping[tuple[str, int], tuple[str, int]],
) -> dict[str, int]:
    """Compare where transfers put frames with where messages have them.

    `in_place`: the message's pixels are the file, offset and bytes that the transfer wrote. Memory
    without a file has no place, and never counts.

    >>> copies({("roi", 1): ("0:1 7 +4096", 9)}, {("roi", 1): ("0:1 7 +4096", 9)})
    {'compared': 1, 'in_place': 1, 'copied': 0}
    """
    both = written.keys() & arrived.keys()
    same = sum(written[key] == arrived[key] and written[key][0] != "" for key in both)
    return {"compared": len(both), "in_place": same, "copied": len(both) - same}


def stages(report: Report, seen: Frames, usage: Usage, plan: Plan) -> list[dict[str, Any]]:
    """Return a row per stage; bytes are of the pictures that it sends, as measured.

    Stages of one process share its processor time, which stands at the first of them.
    """
    sizes: dict[str, dict[str, int]] = {}
    for name, _, _, count in seen:
        sizes.setdefault(SENDERS.get(name) or str(name), {})[name] = count
    rows = []
    told = set[str]()
    exposed = max(1, report["frames"]["exposed"])
    for stage in report["stages"]:
        process = plan.node(stage["node"]).process
        spent_s = 0.0 if process in told else usage.spent_s.get(process, 0.0)
        told.add(process)
        sent = sum(sizes.get(stage["node"], {}).values())
        rows.append({
            "stage": stage["node"], "rate_hz": stage["rate_hz"],
            "handler_p50_ms": stage["latency_ms"]["p50"],
            "handler_p99_ms": stage["latency_ms"]["p99"],
            "process": process,
            "cpu_percent": round(100 * spent_s / usage.elapsed_s, 1),
            "cpu_ms_per_exposure": round(1e3 * spent_s / exposed, 2), "rss_mb": stage["rss_mb"],
            "sent_megabytes_per_s": round(sent * stage["rate_hz"] / 1e6, 1),
        })  # fmt: skip
    return rows


def show(result: Mapping[str, Any]) -> None:
    """Print the figures."""
    click.echo(f"{result['graph']}: {result['format']} at {result['rate_hz']:g} Hz")
    figures = [{"figure": key, "value": result[key]} for key in SINGLE]
    figures += [
        {"figure": f"{key}.{name}", "value": value}
        for key in NESTED
        for name, value in result[key].items()
    ]
    for rows in (figures, *(result[key] for key in TABLES)):
        click.echo(f"\n{table_of(rows)}")


if __name__ == "__main__":
    main()
