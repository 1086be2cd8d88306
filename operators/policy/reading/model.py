"""The network of the policy that reads: features of up to 25 candidates -> logits for Tp frames.

It is the paper's network (model.py). What was shown and read joins the detection part, as both tell
of the text's own state, and so does the rule of gain.py, which the network corrects: before
training it decides as the rule does. The condition is the present window instead of a target.
"""

# mypy: disallow-subclassing-any=False
from pathlib import Path

import torch
from torch import Tensor

from operators.policy.model import WIDTHS, PolicyNet, conditioner, perceptron
from operators.policy.reading.tokens import CONDITION, FEEDBACK, LOOKS, PARTS, SHARE_READ
from operators.policy.tokens import BOX
from operators.training.onnx_files import write

INPUTS = ("roi", "context", "boxes", "predicted", "looks", "rule", "condition", "mask")
PRIOR, LEAST = 3.0, 1e-3  # of the rule: logits are PRIOR log(rule + LEAST) before training


class ReadingNet(PolicyNet):
    """`use` names the parts that are not left out."""

    def __init__(
        self,
        *,
        roi_channels: int = 576,
        context_channels: int = 64,
        observed: int = 4,
        horizon: int = 16,
        use: tuple[str, ...] = PARTS,
    ) -> None:
        super().__init__(
            roi_channels=roi_channels,
            context_channels=context_channels,
            observed=observed,
            horizon=horizon,
            use=use,
        )
        self.detection = perceptron((BOX + 1) * observed + LOOKS + horizon, WIDTHS["detection"])
        self.condition = conditioner(CONDITION)
        last = self.head[-1]
        torch.nn.init.zeros_(last.weight)
        torch.nn.init.zeros_(last.bias)
        told, counted = torch.ones(LOOKS), torch.ones(CONDITION)
        if "feedback" not in use:
            told[list(FEEDBACK)] = counted[SHARE_READ] = 0
        self.register_buffer("told", told)
        self.register_buffer("counted", counted)

    def forward(
        self,
        roi: Tensor,  # (B, N, To, D)
        context: Tensor,  # (B, N, To, C)
        boxes: Tensor,  # (B, N, To, 5)
        predicted: Tensor,  # (B, N, Tp, 4)
        looks: Tensor,  # (B, N, LOOKS)
        rule: Tensor,  # (B, N, Tp)
        condition: Tensor,  # (B, CONDITION)
        mask: Tensor,  # (B, N) bool, True: a candidate
    ) -> Tensor:
        """Logits (B, N, Tp)."""
        parts = {
            "roi": self.roi(roi),
            "global": self.context(context),
            "detection": self.detection(torch.cat([boxes.flatten(2), looks * self.told, rule], -1)),
            "motion": self.motion(predicted.flatten(2)),
        }
        corrected = self.chosen(parts, condition * self.counted, mask)
        return corrected + PRIOR * torch.log(rule + LEAST)


def export(net: ReadingNet, path: Path) -> None:
    """Write an ONNX file with dynamic B and N, and its expected inputs as metadata."""
    s, count = net.sides, 3
    given = {
        "roi": torch.zeros(1, count, s["observed"], s["roi_channels"]),
        "context": torch.zeros(1, count, s["observed"], s["context_channels"]),
        "boxes": torch.zeros(1, count, s["observed"], BOX + 1),
        "predicted": torch.zeros(1, count, s["horizon"], BOX),
        "looks": torch.zeros(1, count, LOOKS),
        "rule": torch.zeros(1, count, s["horizon"]),
        "condition": torch.zeros(1, CONDITION),
        "mask": torch.ones(1, count, dtype=torch.bool),
    }
    both = {0: "b", 1: "n"}
    sides = {name: both for name in (*INPUTS, "logits")} | {"condition": {0: "b"}}
    facts = {name: str(side) for name, side in s.items()}
    write(net, given, path, ("logits",), open_sides=sides, use=" ".join(net.use), **facts)
