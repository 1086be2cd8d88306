"""The policy network: features of up to 25 objects -> logits over them for Tp frames.

Paper, section 3.5 and supplement "Scanpath Selection Policy": a token of 192 numbers per object
from four parts, each normalised separately, in a Set Transformer together with one condition token.
There is no positional encoding, as the order of the objects has no meaning.
"""

# mypy: disallow-subclassing-any=False
from pathlib import Path

import torch
from torch import Tensor, nn

from operators.policy.conditioning import CONDITION
from operators.policy.tokens import BOX, CLASSES, PARTS
from operators.training.onnx_files import write

WIDTHS = {"roi": 64, "global": 64, "detection": 32, "motion": 32}
EMBEDDED, HEADS, LAYERS, FEED_FORWARD = 128, 4, 2, 256
HIDDEN = 96  # of the convolutions along time
NEVER = -1e4  # the logit of padding
INPUTS = ("roi", "context", "boxes", "predicted", "label", "place", "condition", "mask")


class History(nn.Module):
    """Features over To frames -> one vector, by convolution along time."""

    def __init__(self, channels: int, observed: int, width: int) -> None:
        super().__init__()
        self.narrow = nn.Conv1d(channels, HIDDEN, 1)
        self.along = nn.Conv1d(HIDDEN, HIDDEN, 3, padding=1)
        self.whole = nn.Conv1d(HIDDEN, width, observed)

    def forward(self, features: Tensor) -> Tensor:
        """(B, N, To, channels) -> (B, N, width)."""
        b, n, observed, channels = features.shape
        x = features.reshape(b * n, observed, channels).transpose(1, 2)
        x = torch.relu(self.narrow(x))
        x = torch.relu(self.along(x))
        return self.whole(x).reshape(b, n, -1)


def perceptron(inputs: int, width: int) -> nn.Sequential:
    """Numbers -> a vector of `width`."""
    return nn.Sequential(nn.Linear(inputs, 64), nn.ReLU(), nn.Linear(64, width))


def conditioner(inputs: int) -> nn.Sequential:
    """Numbers -> the condition token."""
    return nn.Sequential(
        nn.Linear(inputs, 2 * EMBEDDED), nn.ReLU(), nn.Linear(2 * EMBEDDED, EMBEDDED)
    )


class Layer(nn.Module):
    """A pre-norm encoder layer; torch's own cannot be exported with a dynamic N."""

    def __init__(self) -> None:
        super().__init__()
        self.before = nn.LayerNorm(EMBEDDED)
        self.query_key_value = nn.Linear(EMBEDDED, 3 * EMBEDDED)
        self.project = nn.Linear(EMBEDDED, EMBEDDED)
        self.after = nn.LayerNorm(EMBEDDED)
        self.feed_forward = nn.Sequential(
            nn.Linear(EMBEDDED, FEED_FORWARD), nn.ReLU(), nn.Linear(FEED_FORWARD, EMBEDDED)
        )

    def forward(self, tokens: Tensor, there: Tensor) -> Tensor:
        """(B, N, E), of which (B, N) are there -> (B, N, E)."""
        b, n, _ = tokens.shape
        projected = self.query_key_value(self.before(tokens)).reshape(
            b, n, 3, HEADS, EMBEDDED // HEADS
        )
        query, key, value = projected.permute(2, 0, 3, 1, 4).unbind(0)  # (B, heads, N, E / heads)
        likeness = query @ key.transpose(2, 3) * (EMBEDDED // HEADS) ** -0.5
        likeness = likeness.masked_fill(~there[:, None, None], NEVER)
        attended = (likeness.softmax(-1) @ value).transpose(1, 2).reshape(b, n, EMBEDDED)
        tokens = tokens + self.project(attended)
        return tokens + self.feed_forward(self.after(tokens))


class PolicyNet(nn.Module):
    """About 0.56 M parameters; `use` names the parts that are not left out."""

    def __init__(
        self,
        *,
        roi_channels: int = 576,
        context_channels: int = 64,
        observed: int = 4,
        horizon: int = 16,
        use: tuple[str, ...] = PARTS,
    ) -> None:
        super().__init__()
        self.sides = {"roi_channels": roi_channels, "context_channels": context_channels}
        self.sides |= {"observed": observed, "horizon": horizon}
        self.use = use
        self.roi = History(roi_channels, observed, WIDTHS["roi"])
        self.context = History(context_channels, observed, WIDTHS["global"])
        # besides boxes: visibility, class, and whether it is the prompted position
        self.detection = perceptron((BOX + 1) * observed + CLASSES + 1, WIDTHS["detection"])
        self.motion = perceptron(BOX * horizon, WIDTHS["motion"])
        self.norms = nn.ModuleDict({name: nn.LayerNorm(width) for name, width in WIDTHS.items()})
        self.embed = nn.Linear(sum(WIDTHS.values()), EMBEDDED)
        self.condition = conditioner(CONDITION)
        self.layers = nn.ModuleList(Layer() for _ in range(LAYERS))
        self.head = nn.Sequential(
            nn.LayerNorm(EMBEDDED),
            nn.Linear(EMBEDDED, EMBEDDED),
            nn.ReLU(),
            nn.Linear(EMBEDDED, horizon),
        )

    def forward(
        self,
        roi: Tensor,  # (B, N, To, D)
        context: Tensor,  # (B, N, To, C)
        boxes: Tensor,  # (B, N, To, 5)
        predicted: Tensor,  # (B, N, Tp, 4)
        label: Tensor,  # (B, N, CLASSES)
        place: Tensor,  # (B, N)
        condition: Tensor,  # (B, CONDITION)
        mask: Tensor,  # (B, N) bool, True: an object
    ) -> Tensor:
        """Logits (B, N, Tp)."""
        parts = {
            "roi": self.roi(roi),
            "global": self.context(context),
            "detection": self.detection(torch.cat([boxes.flatten(2), label, place[..., None]], -1)),
            "motion": self.motion(predicted.flatten(2)),
        }
        return self.chosen(parts, condition, mask)

    def chosen(self, parts: dict[str, Tensor], condition: Tensor, mask: Tensor) -> Tensor:
        """Parts of the tokens (B, N, width), condition, mask (B, N) -> logits (B, N, Tp)."""
        normalised = [
            self.norms[name](part) * float(name == "detection" or name in self.use)
            for name, part in parts.items()
        ]
        tokens = torch.cat(
            [self.embed(torch.cat(normalised, -1)), self.condition(condition)[:, None]], 1
        )
        there = torch.cat([mask, torch.ones_like(mask[:, :1])], 1)
        for layer in self.layers:
            tokens = layer(tokens, there)
        logits = self.head(tokens[:, :-1])
        return logits.masked_fill(~mask[..., None], NEVER)


def example(net: PolicyNet, count: int = 3) -> dict[str, Tensor]:
    """Inputs of the right shapes for one moment with `count` objects."""
    s = net.sides
    return {
        "roi": torch.zeros(1, count, s["observed"], s["roi_channels"]),
        "context": torch.zeros(1, count, s["observed"], s["context_channels"]),
        "boxes": torch.zeros(1, count, s["observed"], BOX + 1),
        "predicted": torch.zeros(1, count, s["horizon"], BOX),
        "label": torch.zeros(1, count, CLASSES),
        "place": torch.zeros(1, count),
        "condition": torch.zeros(1, CONDITION),
        "mask": torch.ones(1, count, dtype=torch.bool),
    }


def export(net: PolicyNet, path: Path) -> None:
    """Write an ONNX file with dynamic B and N, and its expected inputs as metadata."""
    both = {0: "b", 1: "n"}
    sides = {name: both for name in (*INPUTS, "logits")} | {"condition": {0: "b"}}
    facts = {name: str(side) for name, side in net.sides.items()}
    given = example(net)
    write(
        net,
        {name: given[name] for name in INPUTS},
        path,
        ("logits",),
        open_sides=sides,
        use=" ".join(net.use),
        **facts,
    )
