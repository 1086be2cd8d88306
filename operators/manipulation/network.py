"""The consumer's network as ONNX: a picture and the joints in, a chunk of targets out."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from operators.manipulation.picture import Region
from pipeline.errors import MessageError, WeightsError
from pipeline.inference import Network
from pipeline.providers import AUTO

WHOLE = "0 0 1 1"


class ActNetwork:
    """Any network with these inputs and one output will do:

    `picture` (1, h, w, 3) uint8 RGB, `joints` (1, n) -> (1, chunk, n) targets in the units of the
    joints. Metadata `workplace`, four shares of the field (xyxy), says what the picture shows; the
    whole field without. Raises `WeightsError` for any other.
    """

    def __init__(
        self, path: Path, *, threads: int = 1, provider: str = AUTO, device: str = ""
    ) -> None:
        self._network = net = Network(path, threads=threads, provider=provider, device=device)
        picture, joints = (list(net.inputs.get(name, [])) for name in ("picture", "joints"))
        told = list(next(iter(net.outputs.values()), []))
        good = (
            len(net.inputs) == 2 and len(net.outputs) == 1 and len(picture) == 4
            and picture[3] == 3 and len(joints) == 2 and len(told) == 3 and told[2] == joints[1]
            and all(isinstance(side, int) for side in (*picture[1:], *joints[1:], *told[1:]))
            and net.input_types["picture"] == "tensor(uint8)"
        )  # fmt: skip
        if not good:
            raise WeightsError(
                f"{path}: expected inputs picture (1, h, w, 3) uint8 and joints (1, n) and an "
                f"output (1, chunk, n), got {net.inputs} and {net.outputs}"
            )
        self.picture_px = int(picture[2]), int(picture[1])
        self.workplace = _region(path, net.metadata.get("workplace", WHOLE))
        self._joints = int(joints[1])
        self.where, self.headline, self.provider = net.where, net.headline, net.provider

    def __call__(
        self, picture: NDArray[np.uint8], joints: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return targets (chunk, n); raises `MessageError` for another number of joints."""
        if joints.shape != (self._joints,):
            raise MessageError(
                f"manipulation.joints: expected {self._joints} joints, got {len(joints)}"
            )
        (told,) = self._network({"picture": picture[None], "joints": joints[None]}).values()
        return np.asarray(told[0], np.float32)


def _region(path: Path, text: str) -> Region:
    try:
        left, top, right, bottom = (float(side) for side in text.split())
    except ValueError:
        left = right = top = bottom = 0.0
    if not (0 <= left < right <= 1 and 0 <= top < bottom <= 1):
        raise WeightsError(f"{path}: workplace: expected four shares of the field, got {text!r}")
    return left, top, right, bottom
