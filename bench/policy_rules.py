"""The rules of the policies, and how to do without each: what `bench.rules` leaves out."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any
from unittest.mock import patch

import numpy as np

from operators.policy.candidates import odds
from operators.policy.flight import Flight
from operators.policy.pursuit import PursuitState
from operators.policy.verdicts import EVEN
from pipeline.errors import RunError

Part = tuple[str, Any]  # module:name or module:class.name, and what stands there instead


@dataclass(frozen=True, kw_only=True)
class Rule:
    """A rule of a policy, and how to do without it."""

    parts: tuple[Part, ...] = ()  # replaced in operators.policy
    changes: tuple[str, ...] = ()  # settings of the graph


def nobody(tracks: Any, *_: Any) -> Any:
    """No track is anything: (n,)."""
    return np.zeros(len(tracks.ids), np.bool_)


def at_rest(_: Any) -> Any:
    """A camera that does not move: (2,)."""
    return np.zeros(2, np.float32)


def returns(value: Any) -> Callable[..., Any]:
    """A function that has one answer to everything."""
    return lambda *_, **__: value


def none_of(*arguments: Any) -> Any:
    """None of the candidates, whose ids are the last argument but one or the last: (n,)."""
    ids = next(a for a in reversed(arguments) if isinstance(a, np.ndarray))
    return np.zeros(len(ids), np.bool_)


def class_locked(state: PursuitState) -> str:
    """Return the class of what was locked last, the class asked for before that."""
    return state.target or state.spec.label


def unseen(tracks: Any, shown: Any) -> Any:
    """Return the odds of tracks of which the ROI showed nothing: (n,)."""
    return odds(tracks, np.full_like(shown, EVEN))


def as_before(_tracks: Any, now: Any, *_: Any) -> Any:
    """The search, with no candidate to look at."""
    return now.search


def alone(_: Any, worth: Any) -> Any:
    """What the window around each track shows, of that track alone: (n,)."""
    return worth


LEARNED = {
    "a person carries the ball": Rule(
        parts=(("target:carrier_of", returns(-1)),)
    ),
    "the prompted place is a candidate": Rule(
        parts=(("decision:encode_place", returns(None)),)
    ),
    "candidates have the prompt's size": Rule(
        parts=(("decision:unlike", none_of),)
    ),
    "the target's own track is likelier": Rule(
        changes=("policy.target_prior=1",)
    ),
    "bound again by the choice": Rule(parts=(("target:_again", returns(-1)),)),
    "places move with the camera": Rule(
        parts=(("target:camera_motion", at_rest), ("conditioning:camera_motion", at_rest)),
    ),
    "people are searched": Rule(
        parts=(("learned:out_of_sight", returns(False)),)
    ),
    "what the ROI showed is an input": Rule(
        parts=(("learned:remember", lambda memory, *_: memory),)
    ),
}  # fmt: skip
PURSUIT = {
    "a candidate is seen three times": Rule(changes=("policy.confirm=1",)),
    "a rival must be clearly better": Rule(parts=(("pursuit:MARGIN", 0.0),)),
    "a rival takes the gaze": Rule(
        parts=(("pursuit:challenged", lambda tracks, now, *_: now),)
    ),
    "what the ROI showed counts": Rule(parts=(("pursuit:odds", unseen),)),
    "an unlikely candidate is none": Rule(
        changes=("policy.least_probability=0",)
    ),
    "the class asked for is kept": Rule(
        parts=(("pursuit:PursuitState.wanted", property(class_locked)),)
    ),
    "what rests is hardly it": Rule(
        changes=("policy.in_play=false",)
    ),
    "what rests for long is hardly it": Rule(parts=(("in_play:RESTED", 1_000_000),)),
    "a person nearby carries it": Rule(parts=(("pursuit:can_carry", nobody),)),
    "it may be further away with time": Rule(parts=(("pursuit:GROWTH", 0.0),)),
    "people are searched": Rule(
        parts=(("pursuit:busiest", returns(None)),)
    ),
    "the field is searched": Rule(changes=("policy.patience=1000000",)),
}  # fmt: skip
VERIFYING = {
    "candidates are looked at": Rule(parts=(("verifying:looked_at", as_before),)),
    "a window shows several candidates": Rule(parts=(("verifying:window_sums", alone),)),
    "near its edge nothing is judged": Rule(parts=(("verifying:EDGE_PX", 0.0),)),
    "what cannot be judged is given up": Rule(parts=(("verifying:LATE", 1_000_000),)),
    "what the context is sure of needs no looks": Rule(
        parts=(("verifying:PLAIN", 1_000_000),)
    ),
    "an unlikely candidate is none": Rule(changes=("policy.least_probability=0",)),
    "a rival must be clearly better": Rule(parts=(("verifying:MARGIN", 0.0),)),
    "the target's odds change slowly": Rule(parts=(("verifying:OWN_GAIN", 1.0),)),
    "a lost target is waited for": Rule(parts=(("verifying:well_known", returns(False)),)),
    "a kicked ball is followed": Rule(parts=(("verifying:next_flight", returns(Flight())),)),
    "people are searched": Rule(parts=(("pursuit:busiest", returns(None)),)),
}  # fmt: skip
RULES: dict[str, dict[str, Rule]] = {  # by policy
    "learned": LEARNED, "pursuit": PURSUIT, "verifying": VERIFYING
}  # fmt: skip


@contextmanager
def without(rule: Rule) -> Iterator[None]:
    """Do without a rule; raises `RunError` where its place is no more."""
    with ExitStack() as stack:
        for place, other in rule.parts:
            module_name, _, name = place.partition(":")
            owner: Any = import_module(f"operators.policy.{module_name}")
            *classes, attribute = name.split(".")
            for part in classes:
                owner = getattr(owner, part, None)
            if not hasattr(owner, attribute):
                raise RunError(f"{place}: expected a rule of operators.policy, got none")
            stack.enter_context(patch.object(owner, attribute, other))
        yield
