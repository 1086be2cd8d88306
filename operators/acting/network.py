"""Inference of the policy that acts: windows and joints -> what looking there gains."""

from pathlib import Path

import numpy as np

from operators.acting.windows import FACTS, Array
from pipeline.errors import MessageError, WeightsError
from pipeline.inference import Network
from pipeline.providers import AUTO

SHIPPED = Path(__file__).with_name("acting.onnx")


class ActingNetwork:
    """The network of one ONNX file; raises `WeightsError` unless it is one of these.

    Inputs `facts` (1, n, 15), `appearance` (1, n, channels) and `joints` (1, j); output `gains`
    (1, n), radians.
    """

    def __init__(
        self, path: Path, *, threads: int = 1, provider: str = AUTO, device: str = ""
    ) -> None:
        self.path = path
        self.network = net = Network(path, threads=threads, provider=provider, device=device)
        sides = {name: list(shape) for name, shape in net.inputs.items()}
        facts, appearance, joints = (
            sides.get(name, []) for name in ("facts", "appearance", "joints")
        )
        good = (
            len(sides) == 3 and set(net.outputs) == {"gains"} and len(facts) == 3
            and facts[2] == FACTS and len(appearance) == 3 and isinstance(appearance[2], int)
            and len(joints) == 2 and isinstance(joints[1], int)
        )  # fmt: skip
        if not good:
            raise WeightsError(
                f"{path}: expected inputs facts (1, n, {FACTS}), appearance (1, n, channels) and "
                f"joints (1, j) and an output gains (1, n), got {net.inputs} and {net.outputs}"
            )
        self.channels, self.joints = int(appearance[2]), int(joints[1])
        self.where, self.headline, self.provider = net.where, net.headline, net.provider

    def __call__(self, facts: Array, appearance: Array, joints: Array) -> Array:
        """Return the gain (n,) of each window; raises `MessageError` for other sizes."""
        if appearance.shape[1:] != (self.channels,):
            raise MessageError(
                f"policy.tracks: {self.path.name} expects {self.channels} features of each object, "
                f"got {appearance.shape[1]}"
            )
        if joints.shape != (self.joints,):
            raise MessageError(f"policy.joints: expected {self.joints} joints, got {len(joints)}")
        given = {"facts": facts[None], "appearance": appearance[None], "joints": joints[None]}
        return np.asarray(self.network(given)["gains"][0], np.float32)
