"""Films of recordings: GIF by Pillow, MP4 by ffmpeg where there is one. The picture is that of the player, in light.

A film of the same recordings has the same frames every time: each is drawn twice as large as it is shown, by whole
numbers, and made smaller.
"""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import math
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from wobblesim.study.errors import StoreError
from wobblesim.viewing.page import COLORS, STRAIN, muscle_color, rgb
from wobblesim.viewing.recording import Floats, Recording

GIF_SECONDS, GIF_RATE, GIF_WIDTH = 10.0, 15.0, 600
"""What a GIF shows if not told otherwise, s and frames a second: it grows by about 0.3 MB a second of two robots."""

MP4_SECONDS, MP4_RATE, MP4_WIDTH = 30.0, 30.0, 960
"""The same of an MP4. A frame of two robots takes about 40 ms."""

LARGER = 2
"""Times that a frame is drawn larger than it is shown."""

NARROWEST, MARGIN = 1.9, 0.75
"""Body lengths across the picture at least, and from the robots' centres to its edges."""

LANES = (280, 180, 150)
"""Height in px, at a width of 600, of the lane of one robot, of each of two, and of each of more."""

TOP, HEAD, GROUND, FOOT = 30, 24, 28, 30
"""px at a width of 600: the time, the words above a lane, the marks under its floor, and the scale of colours."""

MARKS_APART = 60
COLOR = COLORS["light"]


# --- where the camera is -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Track:
    """A recording in body lengths from its start, as the camera needs it; each (n_frames,).

    Attributes
    ----------
    recording : Recording
    x, y : array
        Of the centre.
    smooth : array
        x, averaged over a second: a camera that does not shake.
    tall : array
        Height that the picture has to have.
    """

    recording: Recording
    x: Floats
    y: Floats
    smooth: Floats
    tall: Floats

    @classmethod
    def of(cls, recording: Recording) -> Track:
        """The track of a recording."""
        body, positions = recording.body, recording.positions
        up = recording.floor
        center = positions[:, body.center].mean(axis=1)
        x, y = ((center - (center[0, 0], center[0, 1] if up is None else up)) / body.body_length).T
        second = round(1.0 / recording.times[1]) if len(recording.times) > 1 else 1
        high = (positions[:, :, 1].max(axis=1) - (up or 0.0)) / body.body_length
        tall = np.full(len(x), 1.2) if up is None else _headroom(high, 2 * second)
        return cls(recording, x, y, _averaged(x, second // 2), tall)

    def at(self, values: Floats, time: float) -> float:
        """A value between frames; the last one after the end."""
        return float(np.interp(time, self.recording.times, values))

    def positions(self, time: float) -> Floats:
        """Positions between frames (n_nodes, 2), u."""
        times, positions = self.recording.times, self.recording.positions
        if time >= times[-1]:
            return positions[-1]
        first = int(np.searchsorted(times, time, side="right")) - 1
        part = (time - times[first]) / (times[first + 1] - times[first])
        return positions[first] + (positions[first + 1] - positions[first]) * part


def _averaged(values: Floats, reach: int) -> Floats:
    """Means over as many frames before as after, `reach` of them where there are."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    frame = np.arange(len(values))
    near = np.minimum(reach, np.minimum(frame, frame[::-1]))
    return (sums[frame + near + 1] - sums[frame - near]) / (2 * near + 1)


def _headroom(high: Floats, frames: int) -> Floats:
    """The height above all that is still to come, falling smoothly: the camera only ever comes nearer."""
    still = np.maximum.accumulate(high[::-1])[::-1]
    sums = np.concatenate([[0.0], np.cumsum(still)])
    frame = np.arange(len(high))
    since = np.maximum(frame - frames, 0)
    return 1.05 * (sums[frame + 1] - sums[since]) / (frame + 1 - since)


@dataclass(frozen=True)
class Shot:
    """What all lanes show at a time: the middle of the picture, body lengths, and px a body length."""

    middle: float
    scale: float


def shot(tracks: Sequence[Track], time: float, width: float, height: float) -> Shot:
    """Where the camera is that follows all robots, for a lane of `height` px above the floor."""
    centers = [track.at(track.smooth, time) for track in tracks]
    left, right = min(centers) - MARGIN, max(centers) + MARGIN
    tall = max(track.at(track.tall, time) for track in tracks)
    return Shot((left + right) / 2, min(width / max(right - left, NARROWEST), height / tall))


# --- a picture -----------------------------------------------------------------------------------------------------


@functools.cache
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The font that comes with matplotlib: the same on every machine."""
    import matplotlib as mpl

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(mpl.get_data_path(), "fonts", "ttf", name)), size)


class Canvas:
    """The picture of recordings at any time.

    Parameters
    ----------
    recordings : sequence of Recording
        One lane each, from top to bottom.
    width : int
        px; even, as the height then is.
    """

    def __init__(self, recordings: Sequence[Recording], width: int) -> None:
        self.tracks = [Track.of(recording) for recording in recordings]
        self.unit = LARGER * width / 600  # drawn px of one at a width of 600
        lane = LANES[min(len(recordings), len(LANES)) - 1]
        height = (TOP + len(recordings) * (HEAD + lane + GROUND) + FOOT) * width / 600
        self.size = width, 2 * round(height / 2)
        self.lane = self._px(lane)

    def _px(self, length: float) -> int:
        return round(length * self.unit)

    def picture(self, time: float) -> Image.Image:
        """What is seen at a time, s."""
        width, height = self.size[0] * LARGER, self.size[1] * LARGER
        image = Image.new("RGB", (width, height), COLOR["sky"])
        pen = ImageDraw.Draw(image)
        pen.text((width / 2, self._px(TOP / 2)), f"{time:.1f} s", COLOR["text"], self._letters(15, bold=True), "mm")
        seen = shot(self.tracks, time, width, self.lane)
        top = self._px(TOP)
        for track in self.tracks:
            self._draw_lane(pen, track, time, seen, top)
            top += self._px(HEAD) + self.lane + self._px(GROUND)
        self._draw_scale(pen, top)
        return image.reduce(LARGER)

    def _letters(self, size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
        return _font(self._px(size), bold)

    def _draw_lane(self, pen: Any, track: Track, time: float, seen: Shot, top: int) -> None:
        floor = top + self._px(HEAD) + self.lane
        through = _Lens(track, time, seen, self.size[0] * LARGER / 2, floor, self.lane)
        self._draw_marks(pen, through, track, top, floor)
        self._draw_trail(pen, through, track, time)
        self._draw_robot(pen, through, track.recording, track.positions(time))
        self._draw_pointer(pen, through, track, time, floor)
        self._draw_head(pen, track, time, top)

    def _draw_head(self, pen: Any, track: Track, time: float, top: int) -> None:
        """Which robot it is, and how far it has come."""
        it, y = track.recording, top + self._px(HEAD / 2)
        width, edge = self.size[0] * LARGER, self._px(8)
        distance = f"{_signed(track.at(track.x, time))} body lengths"
        bold = self._letters(13, bold=True)
        ended = f"  {'diverged' if it.status == 'diverged' else 'ended'} at {it.times[-1]:.1f} s"
        run = it.run + (ended if time > it.times[-1] else "")
        taken = 3 * edge + pen.textlength(distance, bold) + pen.textlength(run, self._letters(12))
        name = _fitted(f"{it.condition}  ", lambda text: pen.textlength(text, bold), width - taken)
        pen.rectangle((0, top, width, top + self._px(HEAD)), COLOR["sky"])
        pen.text((edge, y), name, COLOR["text"], bold, "lm")
        pen.text((edge + pen.textlength(name, bold), y), run, COLOR["line"], self._letters(12), "lm")
        pen.text((width - edge, y), distance, COLOR["text"], bold, "rm")

    def _draw_marks(self, pen: Any, through: _Lens, track: Track, top: int, floor: int) -> None:
        """The floor with its distance marks, the unit at the right, numbers where there is room beside it."""
        width, line = self.size[0] * LARGER, max(1, self._px(0.75))
        step = mark_step(through.seen.scale / self.unit)
        half = width / 2 / through.seen.scale
        first, last = math.ceil((through.seen.middle - half) / step), math.floor((through.seen.middle + half) / step)
        pen.rectangle((0, floor, width, floor + self._px(GROUND)), COLOR["ground"])
        for k in range(first, last + 1):
            x = through.mark(k * step)
            pen.line((x, top + self._px(HEAD), x, floor), COLOR["trail" if k == 0 else "ground"], line)
            pen.line((x, floor, x, floor + self._px(6)), COLOR["line"], line)
        if track.recording.floor is not None:
            pen.line((0, floor, width, floor), COLOR["line"], 2 * line)
        letters, y = self._letters(10), floor + self._px(GROUND * 0.66)
        room = width - self._px(6) - pen.textlength("body lengths", letters)
        pen.text((room, y), "body lengths", COLOR["text"], letters, "lm")
        for k in range(first, last + 1):
            label = "start" if k == 0 else f"{k * step:.{1 if step < 1 else 0}f}".replace("-", "\u2212")
            x, reach = through.mark(k * step), pen.textlength(label, letters) / 2
            if reach < x < room - self._px(8) - reach:
                pen.text((x, y), label, COLOR["text"], letters, "mm")

    def _draw_trail(self, pen: Any, through: _Lens, track: Track, time: float) -> None:
        n = int(np.searchsorted(track.recording.times, time, side="right"))
        x, y = np.append(track.x[:n], track.at(track.x, time)), np.append(track.y[:n], track.at(track.y, time))
        way = through.of_lengths(np.stack([x, y], axis=1))
        pen.line([tuple(place) for place in way], COLOR["spring"], max(1, self._px(0.6)))

    def _draw_robot(self, pen: Any, through: _Lens, it: Recording, positions: Floats) -> None:
        body, px = it.body, through.of(positions)
        thick = min(max(9.0 * through.seen.scale / 772, 1.2 * self.unit), 4.0 * self.unit)
        for cell in body.cells:
            pen.polygon([tuple(px[node]) for node in cell], COLOR["skin"])
        is_muscle = np.zeros(body.n_springs, dtype=bool)
        is_muscle[body.muscle_spring] = True
        for a, b in body.springs[~is_muscle]:
            pen.line((*px[a], *px[b]), COLOR["spring"], max(1, round(0.25 * thick)))
        for (a, b), rest in zip(body.springs[body.muscle_spring], body.rest_length[body.muscle_spring], strict=True):
            color = muscle_color(1.0 - math.dist(positions[a], positions[b]) / rest)
            pen.line((*px[a], *px[b]), color, round(thick))
        radius = 0.42 * thick
        for x, y in px:
            pen.ellipse((x - radius, y - radius, x + radius, y + radius), COLOR["node"])

    def _draw_pointer(self, pen: Any, through: _Lens, track: Track, time: float, floor: int) -> None:
        x, wide, tip = through.mark(track.at(track.x, time)), self._px(4), floor + self._px(1.5)
        pen.polygon([(x, tip), (x - wide, tip + 2 * wide), (x + wide, tip + 2 * wide)], COLOR["text"])

    def _draw_scale(self, pen: Any, top: int) -> None:
        """Which colour is which length of a muscle; nothing where there are none."""
        if not any(len(track.recording.body.muscle_spring) for track in self.tracks):
            return
        letters, y, x = self._letters(10), top + self._px(FOOT / 2), self._px(8)
        left, right = f"muscles {STRAIN:.0%} longer ".replace("%", " %"), f" {STRAIN:.0%} shorter".replace("%", " %")
        pen.text((x, y), left, COLOR["text"], letters, "lm")
        x += round(pen.textlength(left, letters))
        wide, half = self._px(90), self._px(4)
        for column in range(wide):
            pen.line((x + column, y - half, x + column, y + half), muscle_color(STRAIN * (2 * column / wide - 1)))
        pen.text((x + wide, y), right, COLOR["text"], letters, "lm")


class _Lens:
    """From u, or body lengths from the start, to px of the picture."""

    def __init__(self, track: Track, time: float, seen: Shot, middle: float, floor: int, height: int) -> None:
        it = track.recording
        flies = it.floor is None
        self.seen, self._middle = seen, middle
        self._start = np.array([it.positions[0, it.body.center, 0].mean(), it.floor or 0.0])
        self._up = floor
        if flies:  # the camera goes up and down with the robot
            self._start[1] = it.positions[0, it.body.center, 1].mean()
            self._up = floor - height / 2 + track.at(track.y, time) * seen.scale
        self._length = it.body.body_length

    def mark(self, lengths: float) -> float:
        return self._middle + (lengths - self.seen.middle) * self.seen.scale

    def of(self, positions: Floats) -> Floats:
        """Places (n, 2) in px of positions in u."""
        return self.of_lengths((positions - self._start) / self._length)

    def of_lengths(self, lengths: Floats) -> Floats:
        """Places (n, 2) in px of body lengths from the start."""
        across = self._middle + (lengths[:, 0] - self.seen.middle) * self.seen.scale
        return np.stack([across, self._up - lengths[:, 1] * self.seen.scale], axis=1)


def mark_step(scale: float) -> float:
    """Distance of marks, 0.1, 0.2, 0.5, 1, 2 ... body lengths: the least far enough apart at px a body length."""
    least = MARKS_APART / scale
    power = 10.0 ** math.floor(math.log10(least))
    return next(k * power for k in (1, 2, 5, 10) if k * power >= least * (1 - 1e-9))


def _fitted(text: str, length: Callable[[str], float], room: float) -> str:
    """A text, its end cut off where there is no room for it."""
    if length(text) <= room:
        return text
    kept = next((n for n in range(len(text) - 1, 0, -1) if length(f"{text[:n]}...  ") <= room), 0)
    return f"{text[:kept]}...  "


def _signed(lengths: float) -> str:
    text = f"{lengths:+.2f}"
    return "+0.00" if text == "-0.00" else text.replace("-", "\u2212")


# --- films ---------------------------------------------------------------------------------------------------------


def moments(recordings: Sequence[Recording], seconds: float, rate: float) -> list[float]:
    """Times of the frames of a film, s."""
    end = min(seconds, max(float(it.times[-1]) for it in recordings))
    return [k / rate for k in range(math.floor(end * rate * (1 + 1e-12)) + 1)]


def gif(
    recordings: Sequence[Recording], seconds: float | None = None, rate: float | None = None, width: int = GIF_WIDTH
) -> bytes:
    """A GIF that repeats itself, with the same bytes for the same recordings and version of Pillow.

    Parameters
    ----------
    recordings : sequence of Recording
    seconds : float, optional
        How much is shown, from the start; `GIF_SECONDS` if not given.
    rate : float, optional
        Frames a second, at most 50; `GIF_RATE` if not given.
    width : int
        px.
    """
    times = moments(recordings, seconds or GIF_SECONDS, min(rate or GIF_RATE, 50.0))
    canvas = Canvas(recordings, width)
    palette = _palette(canvas, times)
    frames = (canvas.picture(time).quantize(palette=palette, dither=Image.Dither.NONE) for time in times)
    out = io.BytesIO()
    next(frames).save(out, "GIF", save_all=True, append_images=frames, duration=_durations(times), loop=0)
    return out.getvalue()


PALETTE_FRAMES = 6


def _palette(canvas: Canvas, times: Sequence[float]) -> Image.Image:
    """255 colours that some frames, equally far apart, are made of."""
    chosen = [times[round(k)] for k in np.linspace(0, len(times) - 1, min(PALETTE_FRAMES, len(times)))]
    width, height = canvas.size
    sheet = Image.new("RGB", (width, height * len(chosen)))
    for place, time in enumerate(chosen):
        sheet.paste(canvas.picture(time), (0, place * height))
    palette = sheet.quantize(255, Image.Quantize.MEDIANCUT)
    return _with_exact(palette, [COLOR[name] for name in EXACT])


EXACT = ("sky", "ground", "text")
"""What covers so much of the picture that it has to have its own colour, and not the mean with others near it."""


NEAR = 12.0
"""Distance of red, green and blue within which such a colour takes the place of others: Pillow's search for the nearest
colour of a palette does not tell them apart."""


def _with_exact(palette: Image.Image, colors: Sequence[str]) -> Image.Image:
    """A palette in which these colours are as they are, in place of the nearest and of all that are near."""
    table = np.array(palette.getpalette(), dtype=np.int64).reshape(-1, 3)
    for wanted in map(rgb, colors):
        distance = np.sqrt(np.square(table - wanted).sum(axis=1))
        table[distance <= max(NEAR, distance.min())] = wanted
    exact = palette.copy()
    exact.putpalette(table.ravel().tolist())
    return exact


LAST_FRAME = 1000
"""ms that the last frame of a GIF stays before it begins again."""


def _durations(times: Sequence[float]) -> list[int]:
    """How long each frame is seen, ms: whole hundredths of a second, as GIF has them, that do not add up to a drift."""
    hundredths = [round(100 * time) for time in times]
    return [10 * (b - a) for a, b in itertools.pairwise(hundredths)] + [LAST_FRAME]


def find_ffmpeg() -> str:
    """Where ffmpeg is.

    Raises
    ------
    StoreError
        If it is not on the PATH.
    """
    if path := shutil.which("ffmpeg"):
        return path
    raise StoreError(
        "MP4 is made by ffmpeg, and no ffmpeg is on the PATH; install it (Debian: apt-get install ffmpeg), "
        "or choose a name that ends in .gif or .html"
    )


def mp4(
    recordings: Sequence[Recording], seconds: float | None = None, rate: float | None = None, width: int = MP4_WIDTH
) -> bytes:
    """An MP4 (H.264, for every browser and slide program), made by ffmpeg.

    Parameters
    ----------
    recordings : sequence of Recording
    seconds : float, optional
        How much is shown, from the start; `MP4_SECONDS` if not given.
    rate : float, optional
        Frames a second; `MP4_RATE` if not given.
    width : int
        px, even.

    Raises
    ------
    StoreError
        If there is no ffmpeg, or it fails.
    """
    ffmpeg, rate = find_ffmpeg(), rate or MP4_RATE
    canvas = Canvas(recordings, width)
    times = moments(recordings, seconds or MP4_SECONDS, rate)
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder, "film.mp4")
        command = [ffmpeg, *_options(canvas.size, rate), str(film)]
        _feed(command, (canvas.picture(time).tobytes() for time in times))
        return film.read_bytes()


def _options(size: tuple[int, int], rate: float) -> list[str]:
    """Raw frames on standard input, a film that any program plays and that can be watched while it is loaded."""
    taken = f"-f rawvideo -pix_fmt rgb24 -s {size[0]}x{size[1]} -r {rate:g} -i -"
    made = "-an -c:v libx264 -pix_fmt yuv420p -preset fast -crf 23 -movflags +faststart"
    return f"-hide_banner -loglevel error -y {taken} {made}".split()


def _feed(command: Sequence[str], frames: Iterable[bytes]) -> None:
    """Give frames to ffmpeg, one after another."""
    with tempfile.TemporaryFile() as said:
        running = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said)  # noqa: S603 - no shell
        assert running.stdin is not None
        try:
            with contextlib.suppress(BrokenPipeError), running.stdin as pipe:  # if it ends early, it says why
                for frame in frames:
                    pipe.write(frame)
        except BaseException:
            running.kill()
            raise
        finally:
            code = running.wait()
        if code:
            said.seek(0)
            why = said.read().decode(errors="replace").strip().partition("\n")[0] or f"exit code {code}"
            raise StoreError(f"ffmpeg made no film: {why}; choose a name that ends in .gif or .html instead")
