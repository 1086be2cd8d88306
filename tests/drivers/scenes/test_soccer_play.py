"""The play behind the pictures: positions of people, ball and camera over time."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.scenes.soccer import SoccerScene
from drivers.scenes.soccer.ball_path import CHUNK_S, RADIUS_M, ball_points, knot, legs
from drivers.scenes.soccer.camera import (
    PITCH_M,
    Station,
    View,
    draw_station,
    draw_style,
    lowest_drop,
    view_at,
)
from drivers.scenes.soccer.play import make_chunk, moment

SEEDS = st.integers(0, 2**31)
CHUNKS = st.integers(0, 10**6)


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, chunk=CHUNKS)
def test_the_legs_of_a_chunk_fill_it_without_gaps(seed: int, chunk: int) -> None:
    found = legs(seed, chunk)

    assert found[0].start_s == pytest.approx(chunk * CHUNK_S)
    assert found[-1].end_s == pytest.approx((chunk + 1) * CHUNK_S)
    for one, two in pairwise(found):
        assert one.end_s == two.start_s
        assert one.end_m == two.start_m
    assert found[-1].end_m == pytest.approx(knot(seed, chunk + 1).place_m)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, chunk=CHUNKS)
def test_the_ball_stays_near_the_pitch_and_above_the_ground(seed: int, chunk: int) -> None:
    points = ball_points(seed, chunk * CHUNK_S + np.arange(0, CHUNK_S, 0.05))

    assert (points[:, :2] > -3).all()
    assert (points[:, :2] < np.array(PITCH_M) + 3).all()
    assert (points[:, 2] >= RADIUS_M - 1e-9).all()
    assert points[:, 2].max() < 14


@settings(max_examples=8, deadline=None)
@given(seed=SEEDS, chunk=CHUNKS)
def test_paths_are_continuous_where_two_chunks_meet(seed: int, chunk: int) -> None:
    one, two = make_chunk(seed, chunk, 0.5), make_chunk(seed, chunk + 1, 0.5)

    np.testing.assert_allclose(one.ball[-1], two.ball[0], atol=1e-6)
    np.testing.assert_allclose(one.people[-1], two.people[0], atol=1e-6)
    np.testing.assert_allclose(one.focus[-1], two.focus[0], atol=1e-6)
    turns = one.phase[-1] - two.phase[0]
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-6)


def test_people_run_at_realistic_speeds() -> None:
    speeds = np.concatenate([make_chunk(5, chunk, 0.5).speed for chunk in range(12)])

    assert 0.8 < np.median(speeds) < 3.5
    assert np.percentile(speeds, 99) < 12


def test_a_person_who_carries_the_ball_is_close_to_it() -> None:
    for seed in range(6):
        for leg in legs(seed, 2):
            if leg.kind == "carry" and leg.end_s - leg.start_s > 0.8:
                now = moment(seed, (leg.start_s + leg.end_s) / 2, 0.5)
                nearest = np.linalg.norm(now.people - now.ball[:2], axis=1).min()
                assert nearest < 2.0


def test_a_keeper_who_holds_the_ball_has_it_at_his_chest() -> None:
    held = 0
    for chunk in range(40):
        first = legs(9, chunk)[0]
        if first.kind == "held":
            now = moment(9, first.start_s + 1.0, 0.5)
            assert now.carrier in (20, 21)
            assert np.linalg.norm(now.people[now.carrier] - now.ball[:2]) < 0.8
            assert now.ball[2] > 1
            held += 1

    assert held >= 1


def test_the_match_has_every_kind_of_moment() -> None:
    kinds = {leg.kind for chunk in range(60) for leg in legs(1, chunk)}

    assert kinds == {"still", "carry", "pass", "lob", "held"}


@pytest.mark.lengthy
def test_size_and_speed_of_the_ball_are_those_of_a_broadcast() -> None:
    sizes, speeds = [], []
    for seed in range(3):
        scene = SoccerScene(size_px=(640, 360), rate_hz=25, seed=seed)
        last = None
        for index in range(150):
            truth = scene.truth(index)
            boxes = {n: b for n, b in zip(truth.labels, truth.boxes, strict=True)}
            ball = boxes.get("ball")
            if ball is not None and last is not None:
                sizes.append(float(ball[2] - ball[0]))
                speeds.append(float(np.hypot(*(ball[:2] + ball[2:] - last[:2] - last[2:]) / 2)))
            last = ball

    assert 3 < np.median(sizes) < 8  # 9 to 24 at 1920 wide
    assert 0.7 < np.mean(speeds) < 4
    assert max(speeds) < 40


@given(
    x=st.floats(-5, 110),
    y=st.floats(-5, 70),
    roll=st.floats(-0.05, 0.05),
    zoom=st.floats(500, 9000),
)
def test_a_point_of_the_ground_is_found_again_from_its_angles(
    x: float, y: float, roll: float, zoom: float
) -> None:
    station = Station(x_m=50, y_m=95, height_m=12)
    view = View(
        station=station, aim=(0.1, 0.2), radius_px=zoom, roll_rad=roll, size_px=(1920, 1080)
    )
    point = np.array([x, y, 0.0])

    angles = station.angles(point)

    np.testing.assert_allclose(station.ground(angles), point[:2], atol=1e-6)
    up = view.pixels(point + np.array([0, 0, 1.0])) - view.pixels(point)
    assert np.hypot(*up) == pytest.approx(float(view.px_per_m(point)))


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, x=st.floats(0, 105), y=st.floats(0, 68), tall=st.booleans())
def test_the_picture_shows_only_directions_that_are_drawn(
    seed: int, x: float, y: float, tall: bool
) -> None:
    rng = np.random.default_rng(seed)
    station, style = draw_station(rng), draw_style(rng)
    size_px = (900, 1600) if tall else (1920, 1080)
    view = view_at(station, style, size_px, np.array([x, y]), 3.0)
    m = view.matrix()
    corners = np.array([(0, 0), (size_px[0], 0), (0, size_px[1]), size_px])

    angles = (corners - m[:, 2]) @ np.linalg.inv(m[:, :2]).T

    slack = 2 * style.jitter_rad
    assert (np.abs(angles[:, 0]) < 1.12 + slack).all()
    assert (angles[:, 1] > -0.2 - slack).all()
    assert (angles[:, 1] < lowest_drop(station) + slack).all()
