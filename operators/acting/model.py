"""The network of the policy that acts: what is known of each window -> what looking there gains.

Each window is judged by itself, beside the best of all windows in each channel, so that their order
does not matter and their number is free.
"""

# mypy: disallow-subclassing-any=False
from pathlib import Path

import torch
from torch import Tensor, nn

from operators.acting.windows import FACTS
from operators.training.onnx_files import write

WIDTH, LOOKS = 96, 16
UNIT = 0.005  # of the gains that the network tells, radians
FAR = 1e4


class ActingNet(nn.Module):
    """`channels`: of the detector's features; `joints`: of the robot."""

    def __init__(self, *, channels: int = 64, joints: int = 14) -> None:
        super().__init__()
        self.sides = {"channels": channels, "joints": joints}
        self.appearance = nn.Sequential(nn.Linear(channels, LOOKS), nn.ReLU())
        self.window = nn.Sequential(
            nn.Linear(FACTS + LOOKS + joints, WIDTH), nn.ReLU(), nn.Linear(WIDTH, WIDTH), nn.ReLU()
        )
        self.head = nn.Sequential(nn.Linear(2 * WIDTH, WIDTH), nn.ReLU(), nn.Linear(WIDTH, 1))
        self.register_buffer("mean", torch.zeros(joints))
        self.register_buffer("spread", torch.ones(joints))

    def forward(
        self,
        facts: Tensor,  # (B, N, FACTS)
        appearance: Tensor,  # (B, N, channels)
        joints: Tensor,  # (B, joints)
        mask: Tensor | None = None,  # (B, N) bool, True: a window; all without
    ) -> Tensor:
        """Gains (B, N) in radians."""
        arms = ((joints - self.mean) / self.spread).unsqueeze(1).expand(-1, facts.shape[1], -1)
        each = self.window(torch.cat([facts, self.appearance(appearance), arms], -1))
        judged = each if mask is None else each.masked_fill(~mask.unsqueeze(-1), -FAR)
        best = judged.max(1, keepdim=True).values.expand_as(each)
        return UNIT * self.head(torch.cat([each, best], -1)).squeeze(-1)


def export(net: ActingNet, path: Path) -> None:
    """Write an ONNX file with any number of windows."""
    count = 3
    given = {
        "facts": torch.zeros(1, count, FACTS),
        "appearance": torch.zeros(1, count, net.sides["channels"]),
        "joints": torch.zeros(1, net.sides["joints"]),
    }
    sides = {"facts": {1: "n"}, "appearance": {1: "n"}, "gains": {1: "n"}}
    write(net, given, path, ("gains",), open_sides=sides)
