"""Decode malformed byte strings: every decoder returns a value or raises a `FoveaError`."""

import random
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from bench.fuzz import nasty
from bench.fuzz.tally import Tally, Watch
from pipeline import codec
from pipeline.bus.envelope import MESSAGE, NOTHING, Envelope
from pipeline.bus.pool import SlotRef
from pipeline.graph.plan import Plan
from pipeline.messages import Detections, Frame, Header, Message, Percept, RoiSchedule
from pipeline.protocol import fleet as wire
from pipeline.protocol.codec import ControlMessage, Kind, Refused, decode, encode
from pipeline.protocol.orders import ORDER, RESULT, StopOrder, StopResult, SwapOrder, SwapResult
from pipeline.protocol.questions import (
    QUESTION,
    Command,
    ConfigQuestion,
    Health,
    HealthQuestion,
    NodeSettings,
    Outcome,
)
from pipeline.protocol.supervision import EVENT, INSTRUCTION, Cut, Go, Standing, Summary

PLAN = Plan(name="g", clock="realtime", nodes=(), edges=())
Reader = Callable[[bytes], Any]
Case = tuple[bytes, Reader]  # valid bytes and what reads them
HEADER = Header(stream="fuzz", seq=7, stamp_ns=1)


def fuzz_wire(count: int, *, seed: int = 0) -> Tally:
    """Decode `count` malformed byte strings, each with its own decoder or with another one."""
    rng, tally, cases = random.Random(seed), Tally(), list(known().values())
    watch = Watch()
    for _ in range(count):
        data, read = _input(rng, cases)
        watch.on = True
        tally.check(data, partial(read, data))
        watch.on = False
    return tally.with_touched(watch.touched)


def known() -> Mapping[str, Case]:
    """Return valid bytes of every kind of message with its decoder, by name."""
    found: dict[str, Case] = {}
    for message in messages():
        cls = type(message)
        found[cls.__name__] = codec.dumps(message), _loader(cls)
        body = codec.pack(message)
        fingerprint = codec.fingerprint(cls)
        found[f"envelope of {cls.__name__}"] = (
            Envelope.render(MESSAGE, 3, 1, fingerprint, None, body), _opener(cls)
        )  # fmt: skip
    slot = SlotRef("eye.out", 7, 1, 2, 4096)
    found["nothing"] = (
        Envelope.render(NOTHING, 3, 1, b"", slot, codec.pack(HEADER)), _opener(Header)
    )  # fmt: skip
    for told, kind in control_messages():
        found[type(told).__name__] = encode(told), _control_reader(kind)
    return found


def control_messages() -> tuple[tuple[ControlMessage, Kind[Any] | type[Any]], ...]:
    """Return one message of each kind between clients, nodes and supervisors, with its decoder."""
    health = Health(
        node="work", process="work", host="", pid=7, epoch=1, state="idle", problem="",
        handled=3, last_seq=2, busy_s=0.0, silent_s=0.1, own_mb=9.5, words="", waiting={"frame": 1},
        dropped={"frame": {"gap": 2}}, broken=("a -> b.frame",),
    )  # fmt: skip
    return (
        (SwapOrder(node="work", changes={"gain": 2.5}), ORDER),
        (StopOrder(), ORDER),
        (SwapResult(node="a", hot=True, gap_ms=1.0, state="none", proven_frames=3), RESULT),
        (StopResult(graph="g", pid=7), RESULT),
        (Refused("no such node"), RESULT),
        (Command("recall", {"last": 3}), QUESTION),
        (ConfigQuestion({"rate_hz": 5.0, "box": [1, 2]}), QUESTION),
        (HealthQuestion(), QUESTION),
        (Outcome(answer={"a": [1, 2.5]}), Outcome),
        (NodeSettings(settings={"a": 1}, live=("a",)), NodeSettings),
        (health, Health),
        *(
            (asked, type(asked))
            for asked in (
                wire.Named("g"),
                wire.Lines("g", "n"),
                wire.Ping(1),
                wire.Lacks(("0" * 64,)),
                wire.ToNode("g", "n", HealthQuestion()),
                wire.Prepare(PLAN, wire.Versions.ours(), {"a": "b"}),
                wire.Accounts(1, "m", True, {0: (1, 2)}, {1: (3,)}),
            )
        ),
        (Go(), INSTRUCTION),
        (Cut(node="work", receiver="here", heard={"frame": 3}), INSTRUCTION),
        (Summary("work", {"mean": 1.5}), EVENT),
        (Standing("work", {"frame": 3}), EVENT),
    )


def messages() -> tuple[Message, ...]:
    """Return one message of each kind that has arrays, ids, texts or windows."""
    boxes, ids = np.ones((2, 4), np.float32), np.arange(2, dtype=np.int32)
    scores = np.ones(2, np.float32)
    return (
        Frame(header=HEADER, pixels=np.ones((2, 3, 3), np.uint8), window=(0, 0, 3, 2)),
        Detections(header=HEADER, boxes=boxes, angles=scores, scores=scores, labels=ids,
                   features=np.ones((2, 3), np.float32), names=("ball", "player")),
        Percept(header=HEADER, boxes=boxes, ids=ids, scores=scores, texts=("a", "b"),
                action=np.zeros(1, np.float32)),
        RoiSchedule(header=HEADER, first_seq=1, windows=np.ones((2, 4), np.int32)),
    )  # fmt: skip


def _input(rng: random.Random, cases: list[Case]) -> Case:
    data, read = rng.choice(cases)
    kind = rng.random()
    if kind < 0.1:
        return rng.randbytes(rng.randrange(120)), read
    if kind < 0.2:
        return data, rng.choice(cases)[1]
    return nasty.flipped(data, rng), read


def _loader(cls: type[Any]) -> Reader:
    return lambda data: codec.loads(cls, data)


def _opener(cls: type[Any]) -> Reader:
    return lambda data: codec.unpack(cls, Envelope.parse(data).body)


def _control_reader(kind: Kind[Any] | type[Any]) -> Reader:
    return lambda data: decode(kind, data)
