"""Act by action chunks: context, ROI and joints -> the targets of the next steps.

The network reads one picture, in which what the ROI shows lies over the enlarged context, and tells
the targets of the next 100 steps. Those that successive chunks tell of a step are averaged
(temporal ensembling).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.robot import Joints
from operators.manipulation.ensemble import Ensemble, EnsembleState
from operators.manipulation.network import ActNetwork
from operators.manipulation.picture import composite
from pipeline import Frame, Header, Input, MessageError, Operator, Percept, SettingsError
from pipeline.providers import NetworkSettings

SHIPPED = Path(__file__).with_name("act.onnx")
MOST_AHEAD = 200


@dataclass(frozen=True, kw_only=True)
class ActionChunkingSettings(NetworkSettings):
    """What a graph may set."""

    weights: str = ""  # an ONNX file; empty: the shipped one
    decay: float = 0.01  # of the weights of chunks, from the oldest on
    ahead: int = 16  # steps told in one message: those after the first are for frames left out

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.decay <= 10:
            raise SettingsError(f"decay: expected 0 to 10, got {self.decay}")
        if not 1 <= self.ahead <= MOST_AHEAD:
            raise SettingsError(f"ahead: expected 1 to {MOST_AHEAD}, got {self.ahead}")


class ActionChunking(Operator[ActionChunkingSettings, Percept]):
    """The consumer of the manipulation task; it has no boxes to tell."""

    context = Input(Frame)
    roi = Input(Frame)
    joints = Input(Joints)

    @classmethod
    def advise(cls, settings: ActionChunkingSettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Nothing; raises `WeightsError` for a network that cannot act."""
        network_of(settings)
        return ()

    def open(self) -> None:
        """Load the network; raises `WeightsError`."""
        self._network = network_of(self.settings)
        self._ensemble = Ensemble(self.settings.decay)

    def on_stream(self, header: Header) -> None:
        """Forget what was told of another stream."""
        self._ensemble = Ensemble(self.settings.decay)

    def on_context_roi_joints(self, context: Frame, roi: Frame, joints: Joints) -> Percept:
        """Return the targets of this frame and of those after it."""
        for name, frame in (("context", context), ("roi", roi)):
            if frame.pixels.size and frame.pixel_format != "rgb8":
                raise MessageError(
                    f"manipulation.{name}: expected rgb8 pixels, got {frame.pixel_format}; put "
                    "operators.downsample:Downsample before it"
                )
        net, seq = self._network, context.header.seq
        picture = composite((context, roi), net.workplace, net.picture_px)
        self._ensemble.add(seq, net(picture, joints.positions))
        targets = self._ensemble.targets(seq, self.settings.ahead)
        return Percept(
            header=context.header,
            boxes=np.zeros((0, 4), np.float32),
            ids=np.zeros(0, np.int32),
            scores=np.zeros(0, np.float32),
            action=targets.reshape(-1),
        )

    def state(self) -> EnsembleState:
        """Return the chunks that still count."""
        return self._ensemble.state()

    def restore(self, state: Any) -> None:
        """Take over the chunks of another instance, unless they are of other joints."""
        self._ensemble.restore(state)

    def summary(self) -> dict[str, str]:
        """What the network runs on."""
        return self._network.where()

    def headline(self) -> str:
        """What the network runs on, unless it is the CPU."""
        return self._network.headline()


def network_of(settings: ActionChunkingSettings) -> ActNetwork:
    """The network that the settings name; raises `WeightsError`."""
    path = Path(settings.weights) if settings.weights else SHIPPED
    return ActNetwork(path, **settings.compute)
