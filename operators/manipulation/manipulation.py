"""Act by action chunks: context, ROI and joints -> the targets of the next steps.

The network reads one picture, in which what the ROI shows lies over the enlarged context and stays
there until the context changes, and tells the targets of the next 100 steps. Those that successive
chunks tell of a step are averaged (temporal ensembling).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.robot import Joints
from operators.manipulation.ensemble import Ensemble, EnsembleState
from operators.manipulation.memory import MemoryState, SharpMemory
from operators.manipulation.network import ActNetwork
from operators.manipulation.picture import covered, shown
from pipeline import Frame, Header, Input, MessageError, Operator, Percept, SettingsError
from pipeline.providers import NetworkSettings

SHIPPED = Path(__file__).with_name("act.onnx")
MOST_AHEAD = 200


@dataclass(frozen=True, kw_only=True)
class ActionChunkingSettings(NetworkSettings):
    """What a graph may set."""

    weights: str = ""  # an ONNX file; empty: the shipped one
    decay: float = 0.01  # of the weights of chunks, from the oldest on
    ahead: int = 100  # steps told in one message: those after the first are for frames left out
    change_levels: float = 6.0  # of 255, between contexts, over which what the ROI showed there is
    # no longer kept; 0: nothing is kept

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.decay <= 10:
            raise SettingsError(f"decay: expected 0 to 10, got {self.decay}")
        if not 1 <= self.ahead <= MOST_AHEAD:
            raise SettingsError(f"ahead: expected 1 to {MOST_AHEAD}, got {self.ahead}")
        if not 0 <= self.change_levels <= 255:
            raise SettingsError(f"change_levels: expected 0 to 255, got {self.change_levels}")


@dataclass(frozen=True, kw_only=True)
class ActionChunkingState:
    """What a successor takes over."""

    ensemble: EnsembleState
    memory: MemoryState


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
        self._memory = SharpMemory(self.settings.change_levels)

    def on_stream(self, header: Header) -> None:
        """Forget what was told and seen of another stream."""
        self._ensemble = Ensemble(self.settings.decay)
        self._memory.forget()

    def on_context_roi_joints(self, context: Frame, roi: Frame, joints: Joints) -> Percept:
        """Return the targets of this frame and of those after it."""
        for name, frame in (("context", context), ("roi", roi)):
            if frame.pixels.size and frame.pixel_format != "rgb8":
                raise MessageError(
                    f"manipulation.{name}: expected rgb8 pixels, got {frame.pixel_format}; put "
                    "operators.downsample:Downsample before it"
                )
        net, seq = self._network, context.header.seq
        self._ensemble.add(seq, net(self._picture(context, roi), joints.positions))
        targets = self._ensemble.targets(seq, self.settings.ahead)
        return Percept(
            header=context.header,
            boxes=np.zeros((0, 4), np.float32),
            ids=np.zeros(0, np.int32),
            scores=np.zeros(0, np.float32),
            action=targets.reshape(-1),
        )

    def _picture(self, context: Frame, roi: Frame) -> NDArray[np.uint8]:
        """What the network is shown of an exposure."""
        where = self._network.workplace, self._network.picture_px
        both = shown((context, roi), *where)
        if not (context.pixels.size and roi.pixels.size):
            return both
        return self._memory.add(shown((context,), *where), both, covered(roi, *where))

    def state(self) -> ActionChunkingState:
        """Return the chunks that still count, and what was seen."""
        return ActionChunkingState(ensemble=self._ensemble.state(), memory=self._memory.state())

    def restore(self, state: Any) -> None:
        """Take over the chunks and pictures of another instance."""
        self._ensemble.restore(state.ensemble)
        self._memory.restore(state.memory)

    def summary(self) -> dict[str, str]:
        """What the network runs on."""
        return self._network.where()

    def headline(self) -> str:
        """What the network runs on, unless it is the CPU."""
        return self._network.headline()

    def runs_on(self) -> str:
        """The provider of the network."""
        return self._network.provider


def network_of(settings: ActionChunkingSettings) -> ActNetwork:
    """The network that the settings name; raises `WeightsError`."""
    path = Path(settings.weights) if settings.weights else SHIPPED
    return ActNetwork(path, **settings.compute)
