"""What is not known of a person does not count, and everything else does."""

from dataclasses import replace

import pytest

pytest.importorskip("torch", reason="needs the train extra")
import torch

from operators.saliency.data import Batch
from operators.saliency.example import ANYONE, INPUT_PX, NAMES
from operators.saliency.losses import has_moved, losses
from operators.saliency.model import STRIDES, Raw, cell_centres

WIDTH, HEIGHT = INPUT_PX
BOX = (100.0, 100.0, 124.0, 160.0)
BALL = NAMES.index("ball")


def raw(player: float = -3.0, referee: float = -3.0) -> Raw:
    """A network that gives these logits, and the box, to the cell in the middle of the person."""
    centres = torch.cat(
        [cell_centres(HEIGHT // s, WIDTH // s, s, torch.device("cpu")) for s in STRIDES]
    )
    boxes = torch.cat([centres - 8, centres + 8], 1)[None].clone()
    scores = torch.full((1, len(centres), 2), -6.0)
    best = int((centres - torch.tensor([112.0, 130.0])).norm(dim=1).argmin())
    boxes[0, best] = torch.tensor(BOX)
    scores[0, best] = torch.tensor([player, referee])
    return Raw(
        scores=scores, boxes=boxes, features=torch.zeros(1, 64, HEIGHT // 8, WIDTH // 8),
        heat=torch.full((1, 1, HEIGHT // 4, WIDTH // 4), -4.0),
        ball=torch.zeros(1, 4, HEIGHT // 4, WIDTH // 4),
    )  # fmt: skip


def batch(label: int, box: tuple[float, ...] = BOX, ignored: bool = False) -> Batch:
    return Batch(
        pictures=torch.zeros(1, 3, HEIGHT, WIDTH), boxes=torch.tensor([[box]]),
        labels=torch.tensor([[label]]), ignored=torch.tensor([[ignored]]),
        difference=torch.zeros(1, 1, HEIGHT, WIDTH),
    )  # fmt: skip


def people(found: Raw, truth: Batch) -> float:
    return float(losses(found, truth)["people"])


def test_anyone_may_be_taken_for_a_player_or_a_referee() -> None:
    assert people(raw(player=3.0), batch(ANYONE)) == pytest.approx(
        people(raw(referee=3.0), batch(ANYONE)), rel=1e-5
    )
    assert people(raw(player=3.0), batch(0)) < people(raw(referee=3.0), batch(0)) - 1


def test_anyone_must_be_found_nevertheless() -> None:
    assert people(raw(), batch(ANYONE)) > people(raw(player=3.0), batch(ANYONE)) + 0.5


def test_both_classes_of_anyone_do_not_count_twice() -> None:
    both, one = people(raw(3.0, 2.0), batch(ANYONE)), people(raw(3.0, -6.0), batch(ANYONE))

    assert both == pytest.approx(one, abs=1e-3)


def test_a_ball_that_may_be_anywhere_makes_no_place_empty() -> None:
    found = raw()
    lit = replace(found, heat=found.heat + 6)
    nowhere, anywhere = batch(-1), batch(BALL, (0.0, 0.0, WIDTH, HEIGHT), ignored=True)

    assert float(losses(lit, nowhere)["heat"]) > 100
    assert float(losses(lit, anywhere)["heat"]) == 0


def ball(*changed: tuple[int, int, int]) -> Batch:
    """Return a ball at 202, 102 and what changed: x, y and levels of places of 5x5 pixels."""
    truth = batch(BALL, (199.0, 99.0, 205.0, 105.0))
    for x, y, levels in changed:
        truth.difference[0, 0, y - 2 : y + 3, x - 2 : x + 3] = levels / 2
    return truth


def moving(found: Batch) -> float:
    """Return the loss of a head for a moving ball that is sure of one there."""
    heat = torch.full((1, 1, HEIGHT // 4, WIDTH // 4), -8.0)
    heat[0, 0, 25, 50] = 8.0
    heads = (heat, torch.zeros(1, 4, HEIGHT // 4, WIDTH // 4))
    return float(losses(replace(raw(), moving=heads), found)["moving heat"])


def test_a_ball_moved_where_it_changed_more_than_noise() -> None:
    assert has_moved(ball((200, 100, 60))).tolist() == [[True]]
    assert has_moved(ball((200, 100, -60))).tolist() == [[True]]
    assert has_moved(ball((200, 100, 6))).tolist() == [[False]]
    assert has_moved(ball((240, 100, 60))).tolist() == [[False]]
    assert has_moved(ball()).tolist() == [[False]]


def test_only_a_ball_that_moved_is_wanted_of_its_head_and_a_still_one_is_not_in_its_way() -> None:
    nothing = batch(BALL, (400.0, 200.0, 406.0, 206.0))

    assert moving(ball((200, 100, 60))) < 1
    assert moving(ball()) < 1  # may be found
    assert moving(nothing) > 5
