"""Tell referees from players by who wears what: Detections and their Frame -> Detections.

A detector knows the kits that it was trained on. A referee in another one is a player to it, but
not beside the other people of the picture: two teams wear the same, a referee's shirt is that of
few or of nobody, above dark shorts. Both are weighed together: what the detector says, and how
alike the kits are. `python -m bench.kits … --fit` fitted the weights; figures are in
saliency/cards/referees.md.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline import Detections, FoveaError, Frame, Input, Operator, SettingsError
from pipeline.boxes import in_picture, iou
from pipeline.colours import colours, differences

Array = NDArray[np.float32]
PLAYER, REFEREE = "player", "referee"
SAME_TORSO, SAME_SHORTS = 18.0, 25.0  # differences in CIELAB at which kits are hardly alike
LEAST_SCORE = 0.02  # stands for a class that the detector did not report
NEVER = -4.0  # least evidence of the others, also where there are none
NAMED = -1.0  # evidence of the detector above which it has named a referee
SAME_PERSON = 0.5  # IoU of two boxes
MOST_LETTERS = 80

# of the signs of a kit (`signs`), and a constant
KIT_WEIGHTS = np.array([-5.774, 1.074, -3.323, 0.6565, -1.006, 0.4597])
# of all that is known (`evidence`), and a constant
WEIGHTS = np.array([0.3748, -0.5164, 0.9062, 0.4349, 0.2899])


@dataclass(frozen=True, kw_only=True)
class KitsSettings:
    """What a graph may set."""

    least_people: int = 6  # in a picture, below which the detector's word counts
    least_evidence: float = 0.0  # logarithm of the odds from which somebody is a referee

    def __post_init__(self) -> None:
        if not 2 <= self.least_people <= 1000:
            raise SettingsError(f"least_people: expected 2 to 1000, got {self.least_people}")
        if not -20 <= self.least_evidence <= 20:
            raise SettingsError(f"least_evidence: expected -20 to 20, got {self.least_evidence:g}")


class Kits(Operator[KitsSettings, Detections]):
    """One answer per frame: the detections, each person once, as player or as referee.

    `frame` is the picture in which they were detected. In one without colours, or with few people,
    all stays as it is. Boxes and scores stay in any case.
    """

    detections = Input(Detections, keep="every")
    frame = Input(Frame, keep="every")

    @classmethod
    def advise(cls, settings: KitsSettings, upstream: Mapping[str, Any]) -> Iterable[str]:
        """Say so where the detector does not know players and referees."""
        try:
            names = getattr(upstream.get("detections"), "reported_classes", None)
        except FoveaError:  # weights that are not there: its own node says so
            names = None
        if names and not {PLAYER, REFEREE} <= set(names):
            known = ", ".join(names)[:MOST_LETTERS]
            return [f"classes stay as they are: no {PLAYER} and {REFEREE} among {known}"]
        return ()

    def on_detections_frame(self, detections: Detections, frame: Frame) -> Detections:
        if not {PLAYER, REFEREE} <= set(detections.names) or frame.pixel_format != "rgb8":
            return detections
        player, referee = (detections.names.index(name) for name in (PLAYER, REFEREE))
        rows, said = people(detections.boxes, detections.scores, detections.labels, player, referee)
        if len(rows) < self.settings.least_people:
            return detections
        picture = np.asarray(frame.pixels, np.uint8)
        worn = np.nan_to_num(colours(picture, in_picture(detections.boxes[rows], frame)))
        odds = evidence(said, worn) @ WEIGHTS[:-1] + WEIGHTS[-1]
        labels = detections.labels.copy()
        labels[rows] = np.where(odds >= self.settings.least_evidence, referee, player)
        others = np.flatnonzero(~np.isin(detections.labels, (player, referee)))
        kept = np.sort(np.concatenate([rows, others]))
        return replace(
            detections,
            boxes=detections.boxes[kept],
            angles=detections.angles[kept],
            scores=detections.scores[kept],
            labels=labels[kept],
            features=detections.features[kept],
        )


def people(
    boxes: Array, scores: Array, labels: NDArray[np.integer], player: int, referee: int
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the surest row of each person (n,), and what the detector says of it: (n, 2).

    That is the logarithm of the odds that it is a referee, and a player. Two boxes of different
    classes may be of the same person.
    """
    rows = np.flatnonzero(np.isin(labels, (player, referee)))
    rows = rows[np.argsort(-scores[rows], kind="stable")]
    same = iou(boxes[rows], boxes[rows]) > SAME_PERSON
    free = np.ones(len(rows), np.bool_)
    first, said = [], []
    for k, row in enumerate(rows):
        if not free[k]:
            continue
        of = rows[same[k] & free]
        free &= ~same[k]
        first.append(row)
        said.append([scores[of][labels[of] == label].max(initial=0) for label in (referee, player)])
    known = np.clip(np.array(said, np.float64).reshape(-1, 2), LEAST_SCORE, 1 - LEAST_SCORE)
    return np.array(first, np.intp), np.log(known / (1 - known))


def signs(worn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what tells a referee's kit among those of a picture, (n, 2, 3): (n, 5).

    The share of the others in such a shirt, how many they are, how many of them in such shorts,
    too (both as logarithms), the logarithm of how many people there are, brightness of the shorts.
    """
    count = len(worn)
    apart = differences(worn[:, None], worn[None])  # (n, n, 2)
    torso = np.exp(-((apart[..., 0] / SAME_TORSO) ** 2))
    both = torso * np.exp(-((apart[..., 1] / SAME_SHORTS) ** 2))
    like, alike = torso.sum(1) - 1, both.sum(1) - 1  # but oneself
    return np.stack(
        [
            like / max(1, count - 1), np.log1p(like), np.log1p(alike),
            np.full(count, np.log(max(1, count))), worn[:, 1, 0] / 50,
        ],
        1,
    )  # fmt: skip


def evidence(
    said: NDArray[np.float64], worn: NDArray[np.float64], weights: NDArray[np.float64] = KIT_WEIGHTS
) -> NDArray[np.float64]:
    """Return what is known of each of n people: (n, 4).

    What the detector says of it as referee and as player, the evidence of its kit, and how much
    that is above the next one's: nothing where the detector has named another one a referee.
    """
    of_kit = signs(worn) @ weights[:-1] + weights[-1]
    others = ~np.eye(len(said), dtype=np.bool_)
    rival = np.where(others, of_kit, NEVER).max(1, initial=NEVER, where=others)
    named = np.where(others, said[:, 0], NEVER).max(1, initial=NEVER, where=others)
    above = np.where(named < NAMED, of_kit - rival, 0.0)
    return np.column_stack([said, of_kit, above])
