"""A labelled still of any size -> a picture of the context's size at a scale that the loop uses.

The loop shows a network three kinds of pictures: a whole broadcast view shrunk to the context,
tiles of a context that shows the whole pitch, and a ROI at full resolution. They differ in the
height of people in pixels, so the scale is chosen by that.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from operators.saliency.augment import MOST_BALL_PX, clutter, cut, paste
from operators.saliency.corners import with_corner
from operators.saliency.example import ANYONE, BALL, CONTEXT_PX, NAMES, Example, resized
from operators.saliency.marks import with_marks
from operators.saliency.movement import in_motion, roughened
from operators.saliency.pasted_balls import paste_balls
from operators.saliency.pasting import (
    Bank,
    is_grass,
    paste_at_boards,
    paste_crowd,
    paste_people,
)
from operators.training.photometric import degrade, recolour

BALL_LABEL = NAMES.index(BALL)
PERSON_PX = (8.0, 60.0)  # height of people after shrinking, from a lean context to a ROI
MOST_ENLARGED = 1.6
ROI_SCALE = (0.6, 2.0)  # pixels of what shows a ROI over those of full resolution
ROI_BALL_PX = 22.0  # diameter of the largest ball there
USUAL_SHARE = 0.45  # of the crops that have the scale of the context, or of a tile
CONTEXT_SHARE = 0.7  # of the pictures for a larger input: what a context shows, enlarged
LEAST_PLAYERS, LEAST_APART = 6, 30.0  # to tell two teams apart: people, levels of colour
WEIGHTS = {BALL_LABEL: 4.0, NAMES.index("referee"): 2.5}  # of what a crop is placed around


def augmented(
    still: Example, bank: Bank, rng: np.random.Generator, size_px: tuple[int, int] = CONTEXT_PX,
    *, roi: bool = False, difference: bool = True,
) -> Example:  # fmt: skip
    """Crop, mirror, add people, balls and corners, recolour kits, litter, degrade.

    For a picture larger than the context most are of its size and then enlarged, as the loop
    does it; the others show as much of the still as a larger context does. With `roi` it shows
    what a ROI does, and more balls, in hands and in flight. `difference`: what changed since the
    frame before is made up as well.
    """
    if roi:
        example = crop(still, rng, size_px, scale=drawn_scale(rng))
    else:
        enlarged = size_px == CONTEXT_PX or rng.random() < CONTEXT_SHARE
        example = crop(still, rng, CONTEXT_PX if enlarged else size_px)
    if rng.random() < 0.5:
        example = mirrored(example)
    if rng.random() < 0.3:
        example = recoloured_kits(example, rng)
    if rng.random() < 0.3:
        example = recoloured_team(example, rng)
    if rng.random() < 0.35:
        example = recoloured_referees(example, rng)
    if difference:
        example = in_motion(example, rng)
    example = paste_people(example, bank, rng)
    example = paste_crowd(example, bank, rng)
    example = paste_at_boards(example, bank, rng)
    if roi:
        example = replace(example, picture=with_marks(example, rng))
    example = paste_balls(example, bank, rng, near=roi)
    if rng.random() < 0.15:
        example = replace(example, picture=clutter(example, rng))
    most_ball_px = ROI_BALL_PX if roi else MOST_BALL_PX
    example = paste(with_corner(example, rng, most_ball_px), rng, most_ball_px)
    picture = recolour(example.picture, rng)
    if rng.random() < 0.15:
        picture = coarser(picture, rng.uniform(0.55, 0.9))
    example = replace(
        example, picture=degrade(picture, rng), difference=roughened(example.difference, rng)
    )
    return resized(example, size_px)


def scale_of(
    still: Example, rng: np.random.Generator, size_px: tuple[int, int] = CONTEXT_PX
) -> float:
    """Pixels of the crop over those of the still, never so few that the still is too small."""
    height, width = still.picture.shape[:2]
    least = max(size_px[0] / width, size_px[1] / height)
    people = still.boxes[still.labels != BALL_LABEL]
    tall = float(np.median(people[:, 3] - people[:, 1])) if len(people) else 54.0
    usual = least if tall * least >= PERSON_PX[0] else 1.0
    if rng.random() < USUAL_SHARE:
        return float(np.clip(usual * rng.uniform(0.85, 1.25), least, MOST_ENLARGED))
    low = max(least, PERSON_PX[0] / tall)
    high = float(np.clip(PERSON_PX[1] / tall, low, MOST_ENLARGED))
    return float(np.exp(rng.uniform(np.log(low), np.log(max(low, high)))))


def drawn_scale(rng: np.random.Generator) -> float:
    """Draw a scale of a ROI: pixels of what shows it over those of full resolution."""
    return float(np.exp(rng.uniform(*np.log(ROI_SCALE))))


def crop(
    still: Example, rng: np.random.Generator, size_px: tuple[int, int] = CONTEXT_PX,
    scale: float | None = None,
) -> Example:  # fmt: skip
    """A random part of the still, mostly around an object; at a random scale unless it is given."""
    height, width = still.picture.shape[:2]
    scale = scale_of(still, rng, size_px) if scale is None else scale
    wide, tall = (min(round(side / scale), most) for side, most in zip(
        size_px, (width, height), strict=True))  # fmt: skip
    left, top = rng.integers(0, width - wide + 1), rng.integers(0, height - tall + 1)
    if len(still.labels) and rng.random() < 0.75:
        weights = np.array([WEIGHTS.get(label, 1.0) for label in still.labels.tolist()])
        box = still.boxes[rng.choice(len(weights), p=weights / weights.sum())]
        x, y = (box[:2] + box[2:]) / 2 + (rng.random(2) - 0.5) * (wide * 0.9, tall * 0.9)
        left = int(np.clip(x - wide / 2, 0, width - wide))
        top = int(np.clip(y - tall / 2, 0, height - tall))
    part = still.picture[top : top + tall, left : left + wide]
    boxes = still.boxes - np.array([left, top] * 2, np.float32)
    return cut(resized(replace(still, picture=part, boxes=boxes), size_px), *size_px)


def mirrored(example: Example) -> Example:
    """Left and right exchanged."""
    width = example.picture.shape[1]
    boxes = example.boxes[:, [2, 1, 0, 3]] * np.array([-1, 1, -1, 1], np.float32)
    difference = example.difference
    return replace(
        example,
        picture=np.ascontiguousarray(example.picture[:, ::-1]),
        boxes=boxes + np.array([width, 0, width, 0], np.float32),
        difference=None if difference is None else np.ascontiguousarray(difference[:, ::-1]),
    )


def recoloured_kits(example: Example, rng: np.random.Generator) -> Example:
    """The colours of all players turned by one angle; referees and grass keep theirs."""
    places = _places(example, (NAMES.index("player"), ANYONE))
    return _dressed(example, places, int(rng.integers(10, 170)), 1.0)


def recoloured_team(example: Example, rng: np.random.Generator) -> Example:
    """One of two teams in black or in one bright colour, as referees are, who are few."""
    places = _places(example, (NAMES.index("player"),))
    teams = two_teams(example, places)
    if teams is None:
        return example
    team = [place for place, own in zip(places, teams == rng.integers(2), strict=True) if own]
    if rng.random() < 0.35:
        return _dressed(example, team, 0, float(rng.uniform(0.15, 0.4)))
    return painted(example, team, rng)


def two_teams(example: Example, places: list[list[int]]) -> NDArray[np.int32] | None:
    """The team, 0 or 1, of the people in some boxes by the colours of their shirts: (n,).

    -1 of whom only grass is seen; none where two teams cannot be told apart. A goalkeeper, who is
    labelled as a player, counts to the team of the more similar shirt.
    """
    shirts = [_shirt(example.picture, place) for place in places]
    seen = [k for k, shirt in enumerate(shirts) if shirt is not None]
    if len(seen) < LEAST_PLAYERS:
        return None
    colours = np.array([shirts[k] for k in seen], np.float32)
    far = np.linalg.norm(colours - colours.mean(0), axis=1).argmax()
    away = np.linalg.norm(colours - colours[far], axis=1)
    begin = (away > np.median(away)).astype(np.int32)[:, None]
    rule = (cv2.TERM_CRITERIA_MAX_ITER, 10, 0.0)
    _, which, middles = cv2.kmeans(colours, 2, begin, rule, 1, cv2.KMEANS_USE_INITIAL_LABELS)
    if np.linalg.norm(middles[0] - middles[1]) < LEAST_APART:
        return None
    teams = np.full(len(places), -1, np.int32)
    teams[seen] = which[:, 0]
    return teams


def _shirt(picture: NDArray[np.uint8], place: list[int]) -> NDArray[np.float64] | None:
    """The mean colour of the upper half of a person; none where only grass is seen."""
    left, top, right, bottom = place
    part = _part(picture, left, top, right, (top + bottom) // 2)
    if not part.size:
        return None
    own = part[~is_grass(cv2.cvtColor(part, cv2.COLOR_RGB2HSV))]
    return np.asarray(own.mean(0)) if len(own) else None


def recoloured_referees(example: Example, rng: np.random.Generator) -> Example:
    """All referees in black, in one bright colour, or their colours turned; others keep theirs.

    Few matches show few kits: what makes a referee is not to be dressed like either team.
    """
    draw, referees = rng.random(), _places(example, (NAMES.index("referee"),))
    if draw < 0.3:
        return _dressed(example, referees, 0, float(rng.uniform(0.15, 0.4)))
    if draw < 0.65:
        return painted(example, referees, rng)
    return _dressed(example, referees, int(rng.integers(10, 170)), 1.0)


def painted(example: Example, places: list[list[int]], rng: np.random.Generator) -> Example:
    """People in some boxes in shirts of one bright colour, whatever they wore; grass stays.

    Turning a hue leaves black black, and most referees of few matches wear black.
    """
    hue, saturation = int(rng.integers(0, 180)), int(rng.integers(90, 256))
    bright, shirt = rng.uniform(120, 235), rng.uniform(0.45, 1.0)  # the shirt, or shorts too
    picture = example.picture.copy()
    for left, top, right, bottom in places:
        low = top + round((bottom - top) * shirt)
        part = _part(picture, left, top, right, low)
        if not part.size:
            continue
        hsv = cv2.cvtColor(part, cv2.COLOR_RGB2HSV)
        own = ~is_grass(hsv)
        if not own.any():
            continue
        value = hsv[..., 2].astype(np.float32)
        hsv[..., 0], hsv[..., 1] = hue, saturation
        hsv[..., 2] = np.clip(bright + (value - value[own].mean()) * 0.7, 0, 255)
        part[own] = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[own]
    return replace(example, picture=picture)


def _part(
    picture: NDArray[np.uint8], left: int, top: int, right: int, bottom: int
) -> NDArray[np.uint8]:
    """What of a box lies in the picture: a view of its pixels."""
    return picture[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)]


def _places(example: Example, labels: tuple[int, ...]) -> list[list[int]]:
    people = example.boxes[np.isin(example.labels, labels)]
    return np.round(people).astype(int).tolist()  # type: ignore[no-any-return]


def _dressed(example: Example, places: list[list[int]], turn: int, light: float) -> Example:
    """People in some boxes with other colours: hue turned in steps of 2 degrees, value scaled."""
    picture = example.picture.copy()
    for left, top, right, bottom in places:
        part = _part(picture, left, top, right, bottom)
        if not part.size:
            continue
        hsv = cv2.cvtColor(part, cv2.COLOR_RGB2HSV)
        green = (hsv[..., 0] > 28) & (hsv[..., 0] < 85)
        hsv[..., 0] = (hsv[..., 0].astype(np.int16) + turn) % 180
        hsv[..., 2] = cv2.convertScaleAbs(hsv[..., 2], alpha=light)
        turned = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)
        part[~green] = turned[~green]
    return replace(example, picture=picture)


def coarser(picture: NDArray[np.uint8], share: float) -> NDArray[np.uint8]:
    """What a leaner context shows, enlarged to the network's input as the letterbox does."""
    height, width = picture.shape[:2]
    size = (max(1, round(width * share)), max(1, round(height * share)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(small, (width, height)), np.uint8)
