"""Films: the same bytes each time, the right length and speed, the picture of the player, a sentence without ffmpeg."""

import io
import itertools
import math
import os
import shutil
import stat
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from viewing.robots import recorded, stretched

import wobblesim as ws
from wobblesim.study.errors import StoreError
from wobblesim.viewing import animation
from wobblesim.viewing.animation import Canvas, Shot, Track, gif, mark_step, moments, mp4, shot
from wobblesim.viewing.page import COLORS, muscle_color, rgb


@pytest.fixture(scope="module")
def pair():
    """Two robots, the second of which moves less."""
    return [recorded(seed=1), recorded(condition="wobbling", seed=1, amplitude=0.3)]


@pytest.fixture(scope="module")
def film(pair):
    """A GIF of both."""
    return gif(pair, seconds=1.0, rate=15.0, width=300)


def frames(film):
    image = Image.open(io.BytesIO(film))
    for number in range(image.n_frames):
        image.seek(number)
        yield image.convert("RGB"), image.info["duration"]


def test_a_gif_has_the_same_bytes_each_time(pair, film):
    assert gif(pair, seconds=1.0, rate=15.0, width=300) == film


def test_a_gif_runs_as_fast_as_the_robot(film):
    shown = [duration for _, duration in frames(film)]
    assert len(shown) == 16
    # Hundredths of a second, as GIF has them: sixteen frames in a second, of 0.06 s or 0.07 s, without a drift.
    assert set(shown[:-1]) == {60, 70}
    assert sum(shown[:-1]) == 1000
    assert shown[-1] == animation.LAST_FRAME


def test_the_frames_differ_and_what_is_large_has_its_exact_colour(film):
    pictures = [np.asarray(picture) for picture, _ in frames(film)]
    assert all((a != b).any() for a, b in itertools.pairwise(pictures))
    assert tuple(pictures[0][2, 2]) == rgb(COLORS["light"]["sky"])


@pytest.mark.parametrize(
    ("seconds", "rate", "expected"),
    [
        (1.0, 4.0, [0.0, 0.25, 0.5, 0.75, 1.0]),
        (99.0, 0.5, [0.0, 2.0, 4.0]),
        (0.1, 4.0, [0.0]),
        (0.3, 10, [0, 0.1, 0.2, 0.3]),
    ],
)
def test_a_film_begins_at_0_and_ends_with_the_recording_or_when_it_is_told_to(pair, seconds, rate, expected):
    assert moments(pair, seconds, rate) == pytest.approx(expected, abs=1e-15)  # measured 6e-17


def test_a_gif_is_10_seconds_at_15_frames_a_second_if_nothing_is_said():
    still = stretched(*np.zeros(41))  # 20 s
    # Frames that are alike are one that stays longer.
    assert sum(duration for _, duration in frames(gif([still], width=40))) == 10_000 + animation.LAST_FRAME
    assert len(moments([still], animation.GIF_SECONDS, animation.GIF_RATE)) == 151


@pytest.mark.parametrize("part", [0.0, 0.1, 0.17, 0.4, -0.06, -0.2])
def test_a_muscle_is_drawn_in_the_colour_that_the_player_has_for_it(part):
    picture = np.asarray(Canvas([stretched(part, part)], 600).picture(0.0))
    # The middle of a line of 4 px has no other colour in it; in the scale below a colour has a few columns of 8 px.
    drawn = (picture == muscle_color(part)).all(axis=2)
    assert np.count_nonzero(drawn.sum(axis=1) > 150) >= 2


def test_the_camera_follows_all_robots_and_keeps_them_in_the_picture(pair):
    fast = replace(pair[0], positions=pair[0].positions + np.outer(pair[0].times, [200.0, 0.0])[:, None, :])
    tracks = [Track.of(fast), Track.of(pair[1])]
    for time in np.linspace(0, 4, 9):
        seen = shot(tracks, time, 600.0, 150.0)
        for track in tracks:
            place = 300.0 + (track.at(track.x, time) - seen.middle) * seen.scale
            assert 0 < place < 600
            assert track.positions(time)[:, 1].max() / 215 * seen.scale < 150.0


def test_the_camera_only_comes_nearer_and_never_cuts_off_what_is_still_to_come():
    high = np.array([5.0, 4.0, 1.0, 2.0, 0.5, 0.5, 0.5, 0.5])
    room = animation._headroom(high, 2)
    slow = [1.05 * np.mean([max(high[k:]) for k in range(max(0, n - 2), n + 1)]) for n in range(len(high))]
    np.testing.assert_allclose(room, slow, rtol=1e-15)
    assert (room >= high).all()
    assert (np.diff(room) <= 1e-12).all()


def test_means_over_frames_before_and_after_are_cut_alike_at_both_ends():
    values = np.array([0.0, 3.0, 6.0, 0.0, 1.0])
    assert animation._averaged(values, 1).tolist() == [0.0, 3.0, 3.0, 7 / 3, 1.0]
    assert animation._averaged(values, 9).tolist() == [0.0, 3.0, 2.0, 7 / 3, 1.0]
    assert animation._averaged(values, 0).tolist() == values.tolist()


@pytest.mark.parametrize(
    ("scale", "step"), [(600.0, 0.1), (599.0, 0.2), (100.0, 1.0), (30.0, 2.0), (12.0, 5.0), (11.9, 10.0)]
)
def test_marks_are_the_least_round_number_of_body_lengths_apart_that_can_be_read(scale, step):
    assert mark_step(scale) == pytest.approx(step, rel=1e-12)


def test_places_between_frames_are_on_the_straight_line_between_them(pair):
    track, it = Track.of(pair[0]), pair[0]
    expected = it.positions[3] + 0.25 * (it.positions[4] - it.positions[3])
    np.testing.assert_allclose(track.positions(0.13), expected, rtol=0, atol=1e-10)  # measured 6e-13
    assert np.array_equal(track.positions(1e9), it.positions[-1])


def test_extremes_can_be_drawn():
    lost = replace(recorded(), status="diverged", performance=math.nan, diverged_at=0.64)
    one = replace(lost, times=lost.times[:1], positions=lost.positions[:1])
    flies = replace(recorded(), floor=None, condition="a-name-as-long-as-names-get" * 3)
    bare = recorded(ws.Body.from_arrays([[0.0, 50.0], [40.0, 50.0]], [[0, 1]]))
    for recordings in ([lost], [one], [flies, bare], [lost, one, flies, bare]):
        picture = Canvas(recordings, 300).picture(2.0)
        assert picture.size[0] == 300
        assert picture.size[1] % 2 == 0
        assert len(picture.getcolors(100_000)) > 20


def test_a_name_too_long_for_the_picture_is_cut():
    assert animation._fitted("short", len, 5) == "short"
    assert animation._fitted("abcdefghijkl", len, 9) == "abcd...  "
    assert animation._fitted("abcdefghijkl", len, 1) == "...  "


# --- ffmpeg --------------------------------------------------------------------------------------------------------


def test_without_ffmpeg_a_sentence_says_what_is_missing_and_what_to_do(pair, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(
        StoreError, match=r"no ffmpeg is on the PATH; install it .* or choose a name that ends in \.gif"
    ):
        mp4(pair)


def stand_in(folder, script):
    """A program named ffmpeg."""
    path = folder / "ffmpeg"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return folder


def test_ffmpeg_is_given_all_frames_as_raw_pixels(pair, monkeypatch, tmp_path):
    stand_in(tmp_path, f'echo "$@" > {tmp_path}/asked; for it in "$@"; do film="$it"; done; cat > "$film"')
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    canvas = Canvas(pair, 100)
    raw = mp4(pair, seconds=0.2, rate=10.0, width=100)
    assert raw == b"".join(canvas.picture(time).tobytes() for time in (0.0, 0.1, 0.2))
    asked = (tmp_path / "asked").read_text()
    width, height = canvas.size
    assert f"-f rawvideo -pix_fmt rgb24 -s {width}x{height} -r 10 -i -" in asked
    assert "-pix_fmt yuv420p" in asked
    assert height % 2 == 0


def test_an_ffmpeg_that_fails_is_told_of_in_its_words(pair, monkeypatch, tmp_path):
    stand_in(tmp_path, 'echo "Unknown encoder: libx264" >&2; exit 3')
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    with pytest.raises(StoreError, match=r"^ffmpeg made no film: Unknown encoder: libx264; choose a name .* instead$"):
        mp4(pair, seconds=4.0, rate=30.0, width=300)


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_an_mp4_is_h264_that_any_program_plays(pair, tmp_path):
    path = tmp_path / "film.mp4"
    path.write_bytes(mp4(pair, seconds=0.5, rate=10.0, width=100))
    asked = ["ffmpeg", "-v", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(asked, capture_output=True, check=True).stdout
    width, height = Canvas(pair, 100).size
    assert len(raw) == 6 * width * height * 3
    wanted = np.asarray(Canvas(pair, 100).picture(0.0), dtype=np.int64)
    found = np.frombuffer(raw, np.uint8).reshape(6, height, width, 3)[0].astype(np.int64)
    assert np.abs(found - wanted).mean() < 6  # of 255: measured 1.9
    assert b"avc1" in path.read_bytes()


def test_a_shot_of_one_robot_is_as_narrow_as_shots_get():
    near = shot([Track.of(stretched(0.0, 0.0))], 0.0, 190.0, 1e6)
    assert near == Shot(0.0, pytest.approx(190.0 / animation.NARROWEST))
