"""The whole pitch: a still view of all of it, read by windows, with exact truth."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.scenes import WholePitchScene
from drivers.scenes.soccer.camera import PITCH_M
from drivers.scenes.soccer.figures import Sprite
from drivers.scenes.soccer.pitch import markings
from drivers.scenes.soccer.skeleton import Pose
from drivers.scenes.soccer.stage import Actor, Cache
from drivers.scenes.whole_pitch.conditions import draw_conditions
from drivers.scenes.whole_pitch.mast import VIEWS, place
from drivers.scenes.whole_pitch.shadows import shadows
from drivers.simulated.sources import open_scene
from drivers.simulated.windows import reads_windows
from drivers.source import WindowSource
from pipeline.errors import DriverError, SettingsError

SMALL = (1280, 720)
ROUNDING = 2.0  # grey levels: of the ground's mean, of the noise's, and of laying a patch over it


@pytest.fixture(scope="module")
def scene() -> WholePitchScene:
    return WholePitchScene(size_px=SMALL, seed=3)


def window(
    scene: WindowSource, index: int, box: tuple[int, int, int, int], reduce: int = 1
) -> NDArray[np.uint8]:
    left, top, right, bottom = box
    out = np.empty(((bottom - top) // reduce, (right - left) // reduce, 3), np.uint8)
    scene.window(index, left, top, right - left, bottom - top, reduce, out)
    return out


def whole(scene: WholePitchScene, index: int, reduce: int) -> NDArray[np.uint8]:
    width, height = (side // reduce * reduce for side in scene.size_px)
    return window(scene, index, (0, 0, width, height), reduce)


def means(picture: NDArray[np.uint8], reduce: int) -> NDArray[np.float64]:
    """Return the exact means over cells of `reduce` x `reduce` pixels."""
    h, w = (side // reduce for side in picture.shape[:2])
    cells = picture[: h * reduce, : w * reduce].reshape(h, reduce, w, reduce, 3)
    return np.asarray(cells.mean((1, 3), dtype=np.float64))


def boxes_of(scene: WholePitchScene, index: int, *labels: str) -> NDArray[np.int64]:
    truth = scene.truth(index)
    chosen = [label in labels for label in truth.labels]
    return np.asarray(truth.boxes[chosen].astype(int))


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("size_px", [(7680, 4320), (7680, 1920), (16320, 9184), (1000, 1000)])
def test_all_of_the_pitch_is_in_the_picture(view: str, size_px: tuple[int, int]) -> None:
    for seed in range(20):
        mast = place(np.random.default_rng(seed), view, size_px)
        for high_m in (0.0, 2.2):
            for path in markings():
                found = mast.view.pixels(mast.seen(path + np.array([0, 0, high_m])))
                assert (found > 0).all()
                assert (found < size_px).all()


@pytest.mark.parametrize("view", VIEWS)
def test_everybody_is_in_the_truth_of_every_frame(view: str) -> None:
    made = WholePitchScene(size_px=SMALL, seed=5, view=view)
    first = made.truth(0)

    for index in range(0, 9000, 700):
        truth = made.truth(index)
        assert truth.ids.tolist() == list(range(1, 27))
        assert truth.labels == first.labels
        assert (truth.boxes[:, :2] >= 0).all()
        assert (truth.boxes[:, 2:] <= made.size_px).all()


def test_people_are_a_hundred_pixels_tall_and_the_ball_a_dozen_at_7680() -> None:
    made = WholePitchScene(size_px=(7680, 1920), seed=7)
    people, ball = [], []
    for index in range(0, 3000, 300):
        boxes = boxes_of(made, index, "player")
        people += (boxes[:, 3] - boxes[:, 1]).tolist()
        ball += (boxes_of(made, index, "ball")[:, 3] - boxes_of(made, index, "ball")[:, 1]).tolist()

    assert 75 < np.median(people) < 115
    assert 9 < np.median(ball) < 15


def test_the_truth_is_where_the_pixels_change() -> None:
    wide = (2560, 1440)
    made, empty = (WholePitchScene(size_px=wide, seed=1, ball=ball) for ball in (True, False))
    found = 0
    for index in range(0, 480, 60):
        truth = made.truth(index)
        which = truth.labels.index("ball")
        if truth.visibility[which] < 0.9:
            continue
        left, top, right, bottom = truth.boxes[which].astype(int)
        around = (left - 40, top - 40, right + 40, bottom + 40)

        changed = np.abs(window(made, index, around).astype(int) - window(empty, index, around))

        strong = changed.sum(2) > 120
        assert strong[40:-40, 40:-40].mean() > 0.4
        strong[38:-38, 38:-38] = False
        assert strong.sum() <= 4  # only its shadow is outside
        found += 1
    assert found >= 4


def test_people_are_inside_their_boxes_and_fill_them() -> None:
    made = WholePitchScene(size_px=(2560, 1440), seed=4, light="floodlight")
    pictures = [made.picture(index).astype(int) for index in (10, 2500)]
    changed = np.abs(pictures[0] - pictures[1]).max(2)
    truths = [made.truth(index) for index in (10, 2500)]
    inside = np.zeros(changed.shape, bool)
    for truth in truths:
        for left, top, right, bottom in truth.boxes.astype(int):
            inside[max(0, top - 3) : bottom + 3, max(0, left - 3) : right + 3] = True

    assert not ((changed > 100) & ~inside).any()  # no shadow changes as much
    filled = 0
    for (left, top, right, bottom), share in zip(
        truths[0].boxes[:25].astype(int), truths[0].visibility, strict=False
    ):
        if share == 1:
            tall = np.flatnonzero((changed > 30)[top:bottom, left:right].any(1))
            filled += tall[0] <= 3 and tall[-1] >= bottom - top - 4
    assert filled >= 0.9 * (truths[0].visibility[:25] == 1).sum() > 10


def test_people_stand_where_the_play_has_them_and_cover_what_is_behind() -> None:
    made = WholePitchScene(size_px=SMALL, seed=2)
    shares = np.array([made.truth(index).visibility for index in range(0, 3000, 120)])

    assert shares.max() == 1
    assert 0 <= shares.min() < 0.9
    assert (shares > 0.9).mean() > 0.8  # they stand apart, and are inside as a whole


def test_the_same_match_is_seen_from_both_sides() -> None:
    """A point of the pitch is right and near in one view, and far and right in the other."""
    masts = {view: place(np.random.default_rng(1), view, (7680, 4320)) for view in VIEWS}
    corner = np.array([[PITCH_M[0], PITCH_M[1], 0.0]])

    main, behind = (masts[v].view.pixels(masts[v].seen(corner))[0] for v in VIEWS)
    middle = np.array([[PITCH_M[0] / 2, PITCH_M[1] / 2, 0.0]])
    main_middle, behind_middle = (masts[v].view.pixels(masts[v].seen(middle))[0] for v in VIEWS)

    assert main[0] > main_middle[0]
    assert main[1] > main_middle[1]
    assert behind[0] > behind_middle[0]
    assert behind[1] < behind_middle[1]


def test_who_is_near_in_one_view_is_aside_in_the_other() -> None:
    views = [WholePitchScene(size_px=SMALL, seed=4, view=view) for view in VIEWS]
    truths = [made.truth(60) for made in views]

    # across the picture from behind the goal is towards the camera on the main stand
    down = truths[0].boxes[:25, 3]
    aside = (truths[1].boxes[:25, 0] + truths[1].boxes[:25, 2]) / 2
    assert np.corrcoef(down, aside)[0, 1] > 0.8


def arcs(light: str, weather: str = "dry") -> tuple[int, float]:
    """Return in how many directions an upright body on the penalty spot throws shadows.

    Also returned is the darkness of the darkest, 0 to 255.
    """
    mast = place(np.random.default_rng(8), "main", (7680, 4320))
    conditions = draw_conditions(np.random.default_rng(8), light, weather)
    spot = mast.view.pixels(np.array([40.0, 44.0, 0.0]))
    left, top = round(float(spot[0])) - 8, round(float(spot[1])) - 100
    body = Actor(
        id=1, label="player", patch=np.full((100, 16, 4), 255, np.uint8), left=left, top=top,
        box=(left, top, left + 16, top + 100), nearer=0.0,
        ground=(float(spot[0]), float(spot[1])), scale=55.0,
    )  # fmt: skip
    (found,) = shadows([body], mast.view, conditions.lamps, 0.0)
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    dark = np.zeros(720)
    for reach in (60, 75, 90):
        rows = spot[1] + 0.62 * reach * np.sin(turn) - found.top
        columns = spot[0] + reach * np.cos(turn) - found.left
        inside = (rows >= 0) & (columns >= 0)
        inside &= (rows < found.patch.shape[0]) & (columns < found.patch.shape[1])
        at = found.patch[rows[inside].astype(int), columns[inside].astype(int)]
        dark[inside] = np.maximum(dark[inside], at)
    shaded = dark > dark.max() / 3
    return int((shaded & ~np.roll(shaded, 1)).sum()), float(dark.max())


def test_floodlight_throws_four_shadows_that_are_weaker_than_the_suns() -> None:
    sun, flood = arcs("sun"), arcs("floodlight")

    assert (sun[0], flood[0]) == (1, 4)
    assert flood[1] < 0.7 * sun[1]
    assert arcs("sun", "rain")[1] < 0.7 * sun[1]


def test_the_stands_are_darker_under_floodlight() -> None:
    stand = (0, 150, 200, 250)
    sun, flood = (
        window(WholePitchScene(size_px=SMALL, seed=6, light=light), 0, stand).mean()
        for light in ("sun", "floodlight")
    )

    assert flood < 0.75 * sun


def test_the_sprites_that_are_kept_have_a_limit() -> None:
    def make(who: int, pose: Pose, height_px: int) -> Sprite:
        return Sprite(image=np.zeros((height_px, 25, 4), np.uint8), feet=(0.0, 0.0))

    cache = Cache(make, 64_000)
    for number in range(300):
        cache(number % 25, Pose(gait="run", phase=number % 8, direction=number % 12), 50)
        assert cache.nbytes <= 64_000

    assert cache.nbytes > 50_000


def test_rain_takes_contrast_from_the_picture_and_puts_drops_into_the_air() -> None:
    dry, rain = (WholePitchScene(size_px=SMALL, seed=6, weather=w) for w in ("dry", "rain"))
    spread = {w: whole(s, 3, 1).astype(float).std() for w, s in (("dry", dry), ("rain", rain))}

    above = (0, 0, 1280, 60)  # the stands, where nothing moves
    falling = [
        np.abs(window(s, 3, above).astype(int) - window(s, 4, above)).max(2) for s in (dry, rain)
    ]

    assert spread["rain"] < 0.95 * spread["dry"]
    assert (falling[1] > 16).sum() > 30
    assert not (falling[0] > 16).any()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"size_px": (40_000, 100)}, "size_px: expected"),
        ({"view": "roof"}, "view: expected main or behind_goal, got 'roof'"),
        ({"light": "moon"}, "light: expected sun or floodlight, got 'moon'"),
        ({"weather": 3}, "weather: expected dry or rain, got 3"),
        ({"seed": -1}, "seed: must be at least 0, got -1"),
        ({"rate_hz": 0.0}, "rate_hz: expected 1 to 1000, got 0.0"),
        ({"length": -1}, "length: must be at least 0, got -1"),
    ],
)
def test_settings_out_of_range_are_refused(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SettingsError, match=sentence):
        WholePitchScene(**options)


@pytest.mark.parametrize(
    ("box", "reduce"), [((-1, 0, 9, 10), 1), ((0, 0, 1280, 721), 1), ((0, 0, 9, 9), 2)]
)
def test_a_window_outside_the_field_is_refused(
    scene: WholePitchScene, box: tuple[int, int, int, int], reduce: int
) -> None:
    with pytest.raises(DriverError, match="whole pitch: expected a window inside 1280x720"):
        window(scene, 0, box, reduce)


def test_a_frame_past_the_end_is_an_index_error() -> None:
    short = WholePitchScene(size_px=SMALL, length=3)

    with pytest.raises(IndexError, match="frame 3: the scene is 3 frames long"):
        short.truth(3)
    with pytest.raises(IndexError, match="frame -1"):
        window(short, -1, (0, 0, 9, 9))


def test_the_soccer_scene_is_drawn_by_the_camera_asked_for() -> None:
    made = {
        camera: open_scene(
            "soccer", size_px=(320, 180), rate_hz=0, seed=1, length=3, options={"camera": camera}
        )
        for camera in ("broadcast", "whole")
    }

    assert isinstance(made["whole"], WholePitchScene)
    assert not reads_windows(made["broadcast"])
    with pytest.raises(SettingsError, match="camera: expected broadcast or whole, got 'drone'"):
        open_scene(
            "soccer", size_px=(0, 0), rate_hz=0, seed=1, length=None, options={"camera": "drone"}
        )


@pytest.mark.parametrize("size_px", [(160, 90), (641, 363), (500, 2000), (6000, 500)])
def test_pictures_of_any_size_are_drawn(size_px: tuple[int, int]) -> None:
    made = WholePitchScene(size_px=size_px, seed=2)

    assert made.picture(30).shape == (size_px[1], size_px[0], 3)
    assert len(made.truth(30).ids) > 0


def test_200_megapixels_take_little_memory_and_agree_at_every_resolution() -> None:
    large = WholePitchScene(size_px=(16_320, 9_184), seed=1)

    context = window(large, 0, (0, 0, 16_320, 9_184), 16)
    roi = window(large, 0, (6000, 2992, 7024, 3568))

    assert context.shape == (574, 1020, 3)
    away = np.abs(means(roi, 16) - context[187:223, 375:439])
    assert np.quantile(away, 0.99) <= ROUNDING
    assert large.kept_bytes < 120 << 20


def test_frames_that_are_kept_show_the_same_and_are_counted() -> None:
    plain, keeping = (WholePitchScene(size_px=SMALL, seed=2, kept_frames=n) for n in (1, 2))
    box = (300, 300, 900, 600)
    order = (0, 1, 0, 2, 1, 0)

    one, other = ([window(scene, k, box) for k in order] for scene in (plain, keeping))

    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)
    assert keeping.kept_bytes > plain.kept_bytes
    with pytest.raises(SettingsError, match="kept_frames: must be at least 1, got 0"):
        WholePitchScene(size_px=SMALL, kept_frames=0)
