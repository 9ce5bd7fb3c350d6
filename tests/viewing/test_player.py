"""The player: what comes out of the page is what was recorded, and every control does what it says."""

import base64
import itertools
import json
import math
import re
import zlib
from dataclasses import replace

import numpy as np
import pytest
from viewing.robots import recorded, stretched

import wobblesim as ws
from wobblesim.viewing.page import COLORS, STRAIN, embedded, muscle_color, rgb
from wobblesim.viewing.player import (
    packed,
    player_data,
    player_page,
    player_script,
    player_style,
    quantum,
    robot_in_words,
    title,
)

PLAYER = "document.querySelector('.wobble-player').player"


def unpacked(coordinates):
    """The slow twin of the script: positions (n_frames, n_nodes, 2) from packed ones, number by number."""
    raw = zlib.decompress(base64.b64decode(coordinates["data"]))
    frames, nodes, planes = (coordinates[name] for name in ("frames", "nodes", "planes"))
    count = 2 * nodes * frames
    assert len(raw) == planes * count
    positions = np.zeros((frames, nodes, 2))
    for series in range(2 * nodes):
        value = change = 0
        for frame in range(frames):
            unsigned = sum(raw[plane * count + series * frames + frame] << 8 * plane for plane in range(planes))
            change += unsigned // 2 if unsigned % 2 == 0 else -(unsigned + 1) // 2
            value += change
            positions[frame, series // 2, series % 2] = value * coordinates["quantum"]
    return positions


# --- the data ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("spread", "planes"), [(0.5, 1), (300.0, 2), (100_000.0, 3), (1e7, 4)])
def test_what_is_packed_comes_back_within_half_a_quantum(spread, planes):
    positions = spread * np.random.default_rng(1).standard_normal((40, 3, 2))
    coordinates = packed(0.04 * np.arange(40), positions, 0.1)
    assert coordinates["planes"] == planes
    assert np.abs(unpacked(coordinates) - positions).max() <= 0.05 * (1 + 1e-6)  # measured 0.0500


def test_the_farthest_that_a_recording_holds_can_be_packed():
    far = np.zeros((6, 1, 2))
    far[1::2] = 1e4 * 5_000 * 10 * 0.1  # 10,000 extents of 50,000 quanta, there and back in each frame
    coordinates = packed(np.arange(6.0), np.where(np.arange(6)[:, None, None] % 4 == 1, far, -far), 0.1)
    assert coordinates["planes"] == 4
    assert np.abs(unpacked(coordinates)).max() == far.max()


def test_one_frame_can_be_packed():
    coordinates = packed(np.zeros(1), np.full((1, 2, 2), -3.0), 0.1)
    assert (coordinates["frames"], coordinates["interval"], coordinates["end"]) == (1, 0.0, 0.0)
    np.testing.assert_allclose(unpacked(coordinates), -3.0, rtol=0, atol=1e-15)  # measured 4e-16


@pytest.mark.parametrize(("side", "expected"), [(772.0, 0.1), (4999.0, 0.1), (5000.0, 1.0), (1.0, 1e-4), (3e-4, 1e-8)])
def test_the_quantum_is_a_power_of_ten_and_a_5000th_of_the_extent_at_most(side, expected):
    body = ws.Body.from_arrays([[0.0, 0.0], [side, 0.1 * side]])
    assert quantum(body) == pytest.approx(expected, rel=1e-12)  # measured 0


def test_a_minute_of_the_starfish_is_a_page_of_less_than_a_megabyte():
    page = player_page([recorded(ws.starfish(), duration=60.0, seed=3)])
    assert len(page.encode()) < 1_000_000  # measured 350,000


def test_data_cannot_end_the_element_that_holds_it_and_holds_no_infinity():
    name = "</script><script>alert(1)</script>&amp;"
    data = player_data([recorded(condition=name)])
    assert not {"<", ">", "&"} & set(data)
    assert json.loads(data)["robots"][0]["condition"] == name
    with pytest.raises(ValueError, match="JSON"):
        embedded({"x": math.inf})
    with pytest.raises(ValueError, match="at least one recording"):
        player_data([])


def test_the_script_needs_nothing_from_elsewhere_and_makes_no_code_of_text():
    for text in (player_script(), player_style()):
        assert not re.search(r"https?:|\beval\b|new Function|innerHTML|import\b|@import|url\(", text)


def test_style_concerns_players_only():
    rules = re.findall(
        r"^\s*([^@{}\s][^{}]*)\{", re.sub(r"/\*.*?\*/", "", player_style(), flags=re.DOTALL), re.MULTILINE
    )
    assert len(rules) > 20
    assert all(part.strip().startswith(".wobble-player") for rule in rules for part in split_selectors(rule))


def split_selectors(rule):
    """Selectors of a rule; commas within brackets do not part them."""
    return re.split(r",(?![^(]*\))", rule)


@pytest.mark.parametrize("scheme", COLORS)
def test_muscles_are_coloured_linearly_between_the_stops_and_clipped_at_the_ends(scheme):
    longest, longer, rest, shorter, shortest = map(rgb, COLORS[scheme]["muscle"])
    for part, color in ((-9.0, longest), (-1.0, longest), (-0.5, longer), (0.0, rest), (0.5, shorter), (1.0, shortest)):
        assert muscle_color(STRAIN * part, scheme) == color
    halfway = muscle_color(0.75 * STRAIN, scheme)
    assert np.abs(np.array(halfway) - (np.array(shorter) + shortest) / 2).max() <= 0.5


# Linear RGB as people without one kind of cone see it: Machado, Oliveira & Fernandes (2009), severity 1.
VISIONS = {
    "usual": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def lab(color, vision):
    """CIE L*a*b* of a colour as it is seen."""
    part = np.array(color) / 255
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(VISIONS[vision]) @ linear, 0, 1)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    f = np.cbrt(np.array(to_xyz) @ seen / [0.9505, 1.0, 1.089])
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISIONS)
@pytest.mark.parametrize("scheme", COLORS)
def test_people_with_any_colour_vision_tell_short_muscles_from_long_ones_and_both_from_the_background(scheme, vision):
    seen = [lab(muscle_color(STRAIN * part, scheme), vision) for part in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    sky = lab(rgb(COLORS[scheme]["sky"]), vision)
    # A difference of 10 is seen at a glance.
    assert np.linalg.norm(seen[0] - seen[4]) > 40
    assert min(np.linalg.norm(a - b) for a, b in itertools.pairwise(seen)) > 10
    assert min(np.linalg.norm(color - sky) for color in seen) > 20


def test_a_title_names_once_what_is_shared():
    fixed, wobbling = recorded(), recorded(condition="wobbling")
    assert title([fixed, wobbling]) == "fixed against wobbling, seed 0, epoch 7"
    assert title([fixed]) == "fixed, seed 0, epoch 7"
    assert title([fixed, replace(wobbling, seed=3)]) == "fixed, seed 0, epoch 7 against wobbling, seed 3, epoch 7"


def test_a_robot_is_told_by_the_factors_that_are_not_the_adults():
    assert robot_in_words(ws.Morphology()) == "the adult"
    assert robot_in_words(ws.Morphology(mass=1.2345, size=0.7)) == "mass × 1.23, size × 0.7"


# --- the page ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pair():
    """A robot against one that moves less."""
    return [recorded(seed=1), recorded(condition="wobbling", seed=1, amplitude=0.3)]


@pytest.fixture
def opened(browser, tmp_path):
    """Opens the page of recordings, unpacked."""
    from contextlib import contextmanager

    @contextmanager
    def open_page(recordings, **options):
        path = tmp_path / "player.html"
        path.write_text(player_page(recordings), encoding="utf-8")
        with browser.page(path, **options) as page:
            page.evaluate(f"{PLAYER}.unpack()")
            yield page

    return open_page


def number(text):
    return float(text.split()[0].replace("\N{MINUS SIGN}", "-"))


def test_the_page_unpacks_the_positions_that_were_recorded(opened, pair):
    with opened(pair) as page:
        for i, recording in enumerate(pair):
            found = np.array(
                page.evaluate(
                    f"([i, times]) => times.map((t) => {PLAYER}.positions(i, t))", [i, recording.times.tolist()]
                )
            ).reshape(recording.positions.shape)
            # Of an extent of 215 u the quantum is 0.01 u; measured 0.0050.
            assert np.abs(found - recording.positions).max() <= 0.005 * (1 + 1e-6)
            assert np.array_equal(found, unpacked(json.loads(player_data([recording]))["robots"][0]["coordinates"]))


def test_between_frames_it_goes_straight_also_to_a_last_one_that_is_nearer(opened):
    times = np.array([0.0, 0.04, 0.08, 0.10])
    whole = recorded(duration=0.12)
    cut = replace(whole, times=times)
    with opened([cut]) as page:
        for time, before, part in ((0.05, 1, 0.25), (0.09, 2, 0.5), (0.1, 2, 1.0), (99.0, 2, 1.0)):
            expected = cut.positions[before] + part * (cut.positions[before + 1] - cut.positions[before])
            found = np.array(page.evaluate(f"{PLAYER}.positions(0, {time})")).reshape(-1, 2)
            assert np.abs(found - expected).max() <= 0.005 * (1 + 1e-6)  # measured 0.0049


def test_time_and_distances_at_a_moment_are_those_of_the_recordings(opened, pair):
    with opened(pair) as page:
        for frame in (0, 30, 77, 100):
            time = float(pair[0].times[frame])
            page.evaluate(f"{PLAYER}.seek({time})")
            assert page.text(".wp-time") == f"{time:.1f} s"
            told = page.texts(".wp-distance")
            assert all(text.endswith(" body lengths") for text in told)
            for text, recording in zip(told, pair, strict=True):
                assert number(text) == pytest.approx(recording.distance[frame], abs=0.0051)  # measured 0.0049
        lead = pair[0].distance[-1] - pair[1].distance[-1]
        ahead = page.texts(".wp-standing")
        assert ahead[0 if lead > 0 else 1] == f"ahead by {abs(lead):.2f}"
        assert ahead[1 if lead > 0 else 0] == ""


def test_play_moves_the_clock_of_both_robots_and_pause_stops_it(opened, pair):
    with opened(pair) as page:
        assert page.evaluate(f"{PLAYER}.playing") is False
        page.click(".wp-play")
        page.wait(f"{PLAYER}.time > 0.2")
        assert page.text(".wp-play") == "Pause"
        page.click(".wp-play")
        stopped = page.evaluate(f"{PLAYER}.time")
        told = page.texts(".wp-distance")
        page.evaluate("new Promise((done) => setTimeout(done, 100))")
        assert page.evaluate(f"{PLAYER}.time") == stopped
        assert page.texts(".wp-distance") == told
        for text, it in zip(told, pair, strict=True):
            assert number(text) == pytest.approx(np.interp(stopped, it.times, it.distance), abs=0.0051)


def test_speed_is_that_of_the_clock_and_the_end_stops_it_and_play_begins_anew(opened, pair):
    with opened(pair) as page:
        page.choose("select", "4")
        page.evaluate(f"{PLAYER}.seek(3.2)")
        began = page.evaluate("performance.now()")
        page.click(".wp-play")
        page.wait(f"{PLAYER}.time === 4 && !{PLAYER}.playing")
        took = page.evaluate("performance.now()") - began
        assert took > 190  # 0.8 s at four times the speed
        page.choose("select", "0.25")
        page.click(".wp-play")
        page.wait(f"{PLAYER}.time > 0")
        assert page.evaluate(f"{PLAYER}.time") < 1.0
        page.click(".wp-reset")
        assert page.evaluate(f"[{PLAYER}.time, {PLAYER}.playing]") == [0, False]


def test_keys_play_step_and_jump(opened, pair):
    with opened(pair) as page:
        page.press("ArrowRight", times=3)  # before anything has the focus
        assert page.text(".wp-time") == "0.3 s"
        page.evaluate("document.querySelector('input[type=range]').focus()")
        page.press("Shift+ArrowRight")
        page.press("ArrowLeft")
        assert page.text(".wp-time") == "1.2 s"
        assert page.evaluate("document.activeElement.getAttribute('aria-valuetext')") == "1.2 s of 4.0 s"
        page.press("End")
        assert page.text(".wp-time") == "4.0 s"
        page.press("Home")
        assert page.text(".wp-time") == "0.0 s"
        page.press("Space")
        page.wait(f"{PLAYER}.playing && {PLAYER}.time > 0")
        page.press("Space")
        assert page.evaluate(f"{PLAYER}.playing") is False


def test_all_controls_have_names_and_can_be_reached_by_keys(opened, pair):
    with opened(pair) as page:
        reached = []
        for _ in range(5):
            page.press("Tab")
            reached.append(
                page.evaluate("document.activeElement.ariaLabel || document.activeElement.labels?.[0]?.textContent "
                              "|| document.activeElement.textContent")
            )  # fmt: skip
        assert [name.strip() for name in reached] == ["Play", "Time", "Speed", "Follow", "To start"]
        labels = page.evaluate("[...document.querySelectorAll('canvas')].map((it) => it.ariaLabel)")
        assert labels[1] == "wobbling, seed 1, epoch 7: the robot from the side"


def test_it_starts_by_itself_unless_the_reader_asks_for_reduced_motion(opened, pair):
    with opened(pair, motion="no-preference") as page:
        page.wait(f"{PLAYER}.playing && {PLAYER}.time > 0")
    with opened(pair, motion="reduce") as page:
        page.evaluate("new Promise((done) => setTimeout(done, 100))")
        assert page.evaluate(f"[{PLAYER}.time, {PLAYER}.playing]") == [0, False]


COPY = """const copy = (canvas) => {  // of which the browser does not say that it is slow to read
  const context = Object.assign(document.createElement("canvas"), { width: canvas.width, height: canvas.height })
    .getContext("2d", { willReadFrequently: true });
  context.drawImage(canvas, 0, 0);
  return context;
};"""
PIXEL = f"""([lane, x, y]) => {{
  {COPY}
  const canvas = document.querySelectorAll("canvas")[lane], ratio = canvas.width / canvas.clientWidth;
  return Array.from(copy(canvas).getImageData(Math.round(x * ratio), Math.round(y * ratio), 1, 1).data);
}}"""
COLORS_DRAWN = f"""() => {{
  {COPY}
  return [...document.querySelectorAll("canvas")].map((canvas) => {{
    const {{ data }} = copy(canvas).getImageData(0, 0, canvas.width, canvas.height);
    return new Set(new Uint32Array(data.buffer)).size;
  }});
}}"""


@pytest.mark.parametrize(("scheme", "scale"), [("light", 1), ("dark", 2)])
def test_a_muscle_is_drawn_in_the_colour_of_its_length(opened, scheme, scale):
    parts = (0.0, 0.1, 0.17, 0.4, -0.05, -0.2)
    bar = stretched(*parts)
    with opened([bar], scheme=scheme, scale=scale) as page:
        for time, part in zip(bar.times, parts, strict=True):
            page.evaluate(f"{PLAYER}.seek({time})")
            middle = float(bar.positions[int(time / 0.5), :, 0].mean())
            x, y = page.evaluate(f"{PLAYER}.pixel(0, {middle}, 100)")
            # The middle of a line of 5 px: no other colour is mixed in. Places are rounded by a ten-thousandth.
            assert page.evaluate(PIXEL, [0, x, y])[:3] == pytest.approx(muscle_color(part, scheme), abs=1)  # measured 0
            told = page.evaluate(f"{PLAYER}.color(0, 0, {time})")
            assert list(map(int, re.findall(r"\d+", told))) == pytest.approx(muscle_color(part, scheme), abs=1)
        sky = page.evaluate(PIXEL, [0, 4, 4])[:3]
        assert tuple(sky) == rgb(COLORS[scheme]["sky"])


def pixel(recording, lane, frame):
    """Asks for the px of the centre of a robot in its lane, as it is in a frame."""
    x, y = recording.positions[frame, recording.body.center].mean(axis=0).tolist()
    return f"{PLAYER}.pixel({lane}, {x}, {y})"


def test_the_robot_is_drawn_where_it_is_and_the_camera_follows_until_it_is_told_not_to(opened, pair):
    runner = replace(pair[0], positions=pair[0].positions + np.outer(pair[0].times, [100.0, 0.0])[:, None, :])
    with opened([runner, pair[1]]) as page:
        width = page.evaluate("document.querySelector('canvas').clientWidth")
        page.evaluate(f"{PLAYER}.seek(4)")
        start = page.evaluate(pixel(runner, 0, 0))[0]
        places = [page.evaluate(pixel(it, lane, -1))[0] for lane, it in enumerate((runner, pair[1]))]
        assert 0 < min(places) < width / 2 < max(places) < width
        # One scale for both lanes: what lies between them is the difference of their distances.
        scale = (places[0] - start) / runner.distance[-1]
        lead = runner.distance[-1] - pair[1].distance[-1]
        assert places[0] - places[1] == pytest.approx(scale * lead, abs=0.2)  # measured 0.01
        page.click("input[type=checkbox]")
        still = page.evaluate(f"{PLAYER}.pixel(0, 0, 0)")
        page.evaluate(f"{PLAYER}.seek(1)")
        assert page.evaluate(f"{PLAYER}.pixel(0, 0, 0)") == still
        assert min(page.evaluate(COLORS_DRAWN)) > 30  # an empty canvas has one


def test_canvases_have_the_pixels_of_the_screen_and_follow_the_window(opened, pair):
    ratio = (
        "[...document.querySelectorAll('canvas')].map((it) => [it.width / it.clientWidth, it.height / it.clientHeight])"
    )
    with opened(pair, width=375, height=700, scale=2) as page:
        assert page.overflow == 0
        assert np.array(page.evaluate(ratio)) == pytest.approx(2.0, abs=0.02)
        page.resize(1000, 700)
        page.wait("document.querySelector('canvas').clientWidth > 900")
        page.wait("document.querySelector('canvas').width > 1800")
        assert np.array(page.evaluate(ratio)) == pytest.approx(2.0, abs=0.02)
        assert page.overflow == 0


def test_a_name_as_long_as_names_get_does_not_widen_a_phone(opened):
    long = recorded(
        condition="dimension-mass_amplitude-0.1_period-25_upper_bound-1.0_decay_start-1900_mean-0.95", seed=2
    )
    with opened([long, replace(long, condition="x" * 80)], width=375) as page:
        assert page.overflow == 0


def test_one_that_ends_earlier_waits_at_its_end_and_says_if_it_diverged(opened, pair):
    lost = replace(
        pair[1], times=pair[1].times[:51], positions=pair[1].positions[:51], status="diverged", bound="speed",
        performance=math.nan, stored=math.nan, diverged_at=2.24,
    )  # fmt: skip
    with opened([pair[0], lost]) as page:
        page.evaluate(f"{PLAYER}.seek(3)")
        assert page.text(".wp-note").startswith("This trial diverged: it left the trusted bounds (speed)")
        assert page.texts(".wp-standing")[1] == "diverged at 2.0 s"
        assert number(page.texts(".wp-distance")[1]) == pytest.approx(lost.distance[-1], abs=0.0051)
        assert page.text("table").split("\n")[-1].split("\t")[1] == "no score"


def test_in_free_flight_the_camera_goes_down_with_the_robot(opened, pair):
    falling = pair[0].positions - np.outer(pair[0].times ** 2, [0.0, 50.0])[:, None, :]
    diver = replace(pair[0], floor=None, positions=falling)
    with opened([diver]) as page:
        page.evaluate(f"{PLAYER}.seek(4)")
        height = page.evaluate("document.querySelector('canvas').clientHeight")
        assert page.evaluate(pixel(diver, 0, -1))[1] == pytest.approx(height / 2, abs=5)  # measured 0.1


@pytest.mark.parametrize("frames", [1, 2])
def test_a_recording_of_a_frame_or_two_can_be_shown(opened, pair, frames):
    short = replace(pair[0], times=pair[0].times[:frames], positions=pair[0].positions[:frames])
    with opened([short]) as page:
        page.evaluate(f"{PLAYER}.seek(1)")
        assert number(page.text(".wp-distance")) == pytest.approx(short.distance[-1], abs=0.0051)


def test_names_are_text_and_never_markup(opened, pair):
    evil = "<img src=x onerror=alert(1)></script><script>throw 1</script>"
    with opened([replace(pair[0], condition=evil)]) as page:
        assert page.text(".wp-name") == evil
        assert page.text("tbody th") == evil
        assert page.evaluate("document.images.length") == 0


def test_without_decompression_or_scripts_a_sentence_says_what_is_missing(browser, tmp_path, pair):
    path = tmp_path / "old.html"
    path.write_text(player_page(pair).replace("<script>", "<script>delete globalThis.DecompressionStream;", 1))
    with browser.page(path) as page:
        assert page.text(".wp-message").startswith("This browser cannot unpack the recording")
        assert page.evaluate("document.querySelector('.wp-play').disabled")
    with browser.page(path, scripts=False) as page:
        assert "allow scripts to watch them" in page.text("body")


def test_data_that_are_cut_are_said_to_be(browser, tmp_path, pair):
    page_text = player_page(pair)
    data = json.loads(re.search(r'id="data">(.*?)</script>', page_text)[1])
    cut = embedded(
        data | {"robots": [data["robots"][0] | {"coordinates": data["robots"][0]["coordinates"] | {"planes": 3}}]}
    )
    path = tmp_path / "cut.html"
    path.write_text(re.sub(r'(id="data">).*?(</script>)', lambda found: found[1] + cut + found[2], page_text))
    with browser.page(path) as page:
        page.wait("!document.querySelector('.wp-message').hidden")
        assert page.text(".wp-message") == "The recording cannot be unpacked: its length is not what it says."


def test_several_players_live_on_a_page_each_unpacked_when_it_comes_near(browser, tmp_path, pair):
    data = [player_data(pair[:1]), player_data(pair[1:])]
    path = tmp_path / "two.html"
    path.write_text(
        f"<!doctype html><style>{player_style()}</style><script>{player_script()}</script><div id=a></div>"
        f"<div style='height: 6000px'></div><div id=b></div><script type='application/json'>{data[0]}</script>"
        f"<script type='application/json'>{data[1]}</script><script>"
        "const stored = document.querySelectorAll('script[type]');"
        "for (const [i, id] of ['a', 'b'].entries())"
        "  mountPlayer(document.getElementById(id), stored[i].textContent);</script>",
        encoding="utf-8",
    )
    with browser.page(path) as page:
        page.wait("document.querySelector('#a .wp-distance').textContent !== ''")
        assert page.evaluate("document.querySelector('#b .wp-distance').textContent") == ""
        page.press("ArrowRight")  # whose it is cannot be known
        assert page.evaluate("document.getElementById('a').player.time") == 0
        page.evaluate("document.getElementById('b').scrollIntoView()")
        page.wait("document.querySelector('#b .wp-distance').textContent !== ''")
        page.click("#b .wp-play")
        page.wait("document.getElementById('b').player.time > 0")
        assert page.evaluate("document.getElementById('a').player.time") == 0


def test_another_scheme_of_colours_is_taken_at_once(opened, pair):
    with opened(pair) as page:
        page.prefer("dark")
        sky = list(rgb(COLORS["dark"]["sky"]))
        page.wait(f"(place) => String(({PIXEL})(place)) === '{','.join(map(str, [*sky, 255]))}'", [0, 4, 4])
        assert page.evaluate("getComputedStyle(document.body).backgroundColor") != "rgb(250, 251, 252)"
