"""The operators of a graph without its runner: in one process, with random access to frames.

What the loop computes from the context does not depend on where the ROI is. It is computed once for
a clip, and every episode adds only policy, encoder and tracker. A test compares the result with the
in-line runner on the shipped graph. A detector that also looks where the sensor does
(`MovedSaliency.roi`) is played without that, the same for every strategy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.tracking.classes import POLICY, planned
from pipeline import settings as checked
from pipeline.contract import Operator, settings_of
from pipeline.errors import GraphError
from pipeline.executor import Executor, carried
from pipeline.graph.plan import load_operator
from pipeline.messages import Detections, Frame, Header, Message, RoiFeatures, Tracks

SALIENCY, ASSOCIATION = "saliency", "association"
ENCODER, VERIFIER = "roi_features", "verify"
VERIFYING = ("closer", VERIFIER)  # played with the encoder where the policy reads the verifier
KITS = "kits"  # played with saliency where association reads it
NEEDED = ("downsample", "saliency", "association", "roi_features", "policy", "dispatch", "tracker")


class Stages:
    """The opened operators of a tracking graph, by node name; use it as a context manager."""

    def __init__(
        self,
        graph: Path,
        changes: Sequence[str] = (),
        tracker: str = "",
        policy: str = "",
        needed: Sequence[str] = NEEDED,
    ) -> None:
        self.plan = planned(graph, changes, tracker, policy)
        known = {node.name for node in self.plan.nodes}
        if POLICY in needed and POLICY in known:
            needed = (*needed, *self._before_policy(graph))
        if ASSOCIATION in needed and ASSOCIATION in known:
            needed = (*needed, *self._before_association(graph))
        for name in needed:
            if name not in known:
                raise GraphError(
                    f"{graph}: tracking is evaluated on {', '.join(needed)}; no {name}"
                )
        self._parts: dict[str, Operator[Any, Any]] = {}
        self._executors: dict[str, Executor] = {}
        self._own: dict[str, Any] = {}  # settings, as the graph has them
        for name in needed:
            node = self.plan.node(name)
            cls = load_operator(node.operator)
            self._parts[name] = cls(checked.build(settings_of(cls), node.settings, name))
            self._own[name] = self._parts[name].settings
            self._executors[name] = Executor(name, self._parts[name])

    def _before_policy(self, graph: Path) -> tuple[str, ...]:
        """Return the further stages that a policy needs; raises `GraphError` for unknown ones."""
        inputs = self.plan.inputs(POLICY)
        if "percept" in inputs:
            raise GraphError(
                f"{graph}: policy.percept: expected a policy that hears no tracker, got one that "
                "does: its windows would depend on the tracker, which is not played here"
            )
        source = inputs["features"].source if "features" in inputs else ENCODER
        if source not in (ENCODER, VERIFIER):
            raise GraphError(
                f"{graph}: policy.features: expected {ENCODER} or {VERIFIER}, which are played "
                f"here, got {source}"
            )
        return VERIFYING if source == VERIFIER else ()

    def _before_association(self, graph: Path) -> tuple[str, ...]:
        """Return the further stage that association needs; raises `GraphError` for another one."""
        inputs = self.plan.inputs(ASSOCIATION)
        if "frame" in inputs and (shown := inputs["frame"].source) != "downsample":
            raise GraphError(
                f"{graph}: association.frame: expected downsample, which is played here, "
                f"got {shown}"
            )
        source = inputs["detections"].source
        if source not in (SALIENCY, KITS):
            raise GraphError(
                f"{graph}: association.detections: expected {SALIENCY} or {KITS}, which are played "
                f"here, got {source}"
            )
        return (KITS,) if source == KITS else ()

    def settings(self, name: str) -> Any:
        """Return the settings of a stage, defaults included."""
        return self._parts[name].settings

    def __enter__(self) -> "Stages":
        try:
            for part in self._parts.values():
                part.open()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for part in self._parts.values():
            part.close()

    def begin(self, header: Header, *names: str, **settings: Mapping[str, Any]) -> None:
        """Begin a new stream for some stages, with these of the graph's settings changed.

        What verifies begins with the encoder, kits with saliency.
        """
        verifying = VERIFYING if ENCODER in names and VERIFIER in self._parts else ()
        kits = (KITS,) if SALIENCY in names and KITS in self._parts else ()
        for name in (*names, *verifying, *kits):
            part = self._parts[name]
            part.on_settings(replace(self._own[name], **settings.get(name, {})))
            part.on_stream(header)

    def state(self, name: str) -> Any:
        """Return the state of a stage, as another instance would take it over."""
        return self._parts[name].state()

    def restore(self, name: str, state: object) -> None:
        """Let a stage go on from the state of another instance."""
        self._parts[name].restore(state)

    def finds(self, picture: Frame) -> Detections:
        """Return what association hears of a picture: what saliency finds, told by kits."""
        found: Detections = self.call(SALIENCY, frame=picture)
        if KITS in self._parts:
            found = self.call(KITS, detections=found, frame=picture)
        return found

    def tracks(self, detections: Detections, picture: Frame) -> Tracks:
        """Return what association makes of detections in a picture, which its graph may show it."""
        shown = {"frame": picture} if "frame" in self.plan.inputs(ASSOCIATION) else {}
        tracks: Tracks = self.call(ASSOCIATION, detections=detections, **shown)
        return tracks

    def looks(self, roi: Frame, tracks: Tracks) -> RoiFeatures:
        """Return what the policy hears of a ROI: what the encoder tells, verified in its graph."""
        features: RoiFeatures = self.call(ENCODER, roi=roi, tracks=tracks)
        if VERIFIER in self._parts:
            closer = self.call("closer", frame=roi)
            features = self.call(VERIFIER, features=features, closer=closer, tracks=tracks, roi=roi)
        return features

    def call(self, name: str, **messages: Message) -> Any:
        """Pass one set of messages to a stage; return its answer, None for nothing.

        As in a graph, the stage cannot write into them, and a wrong answer raises `RunError` or
        `MessageError`.
        """
        given = {key: carried(message, f"{name}.{key}") for key, message in messages.items()}
        answer = self._executors[name].call(given).get("out")
        return None if answer is None else carried(answer, f"{name}.out")
