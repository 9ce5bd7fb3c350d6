"""The player: recordings in a page, drawn on canvases by a script that needs no library and no network.

Any page can hold players. It needs, once, the style `player_style()` and the script `player_script()`, which defines
``mountPlayer(element, payload)``; and for each player an empty element and the text of `player_data(recordings)`, which
is safe in a script element::

    <style>...</style> <script>...</script>
    <div id="a"></div>
    <script type="application/json" id="a-data">...</script>
    <script>mountPlayer(document.getElementById("a"), document.getElementById("a-data").textContent);</script>

The style concerns nothing outside the elements, which get the class ``wobble-player``. The robots of a player share a
clock and a scale. Coordinates are unpacked when the element comes near the window. ``mountPlayer`` returns, and puts at
``element.player``, an object to play, pause and seek with; ``{autoplay: true}`` as a third argument starts it, unless
the reader's system asks for reduced motion.

Coordinates are rounded to a quantum, a 5000th of the robot's extent or less (0.1 u for the starfish), and written as
second differences in time, which are small and exact; their bytes, node by node, the low ones first, are compressed by
zlib. A minute of the starfish takes 0.26 MB so; with first differences 0.34 MB, with third ones 0.25 MB.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wobblesim.robot.body import Body
from wobblesim.robot.morphology import Morphology
from wobblesim.viewing.page import COLORS, STRAIN, asset, embedded, render
from wobblesim.viewing.recording import Floats, Recording, extent

FORMAT = 1
"""Of the data; the script refuses others."""

PARTS_OF_EXTENT = 5_000
"""Into which the larger side of a robot is divided at least."""


def player_script() -> str:
    """The script that defines ``mountPlayer``."""
    return asset("player.js")


def player_style() -> str:
    """The style of players."""
    return asset("player.css")


def player_data(recordings: Sequence[Recording]) -> str:
    """What a player shows, as JSON that may stand in a script element.

    Parameters
    ----------
    recordings : sequence of Recording
        One lane each, from top to bottom.

    Raises
    ------
    ValueError
        If there is none.
    """
    if not recordings:
        raise ValueError("a player needs at least one recording")
    return embedded({"format": FORMAT, "strain": STRAIN, "colors": COLORS, "robots": [_robot(it) for it in recordings]})


def player_page(recordings: Sequence[Recording]) -> str:
    """A whole HTML page with one player, which opens from a disk.

    Raises
    ------
    ValueError
        If there is no recording.
    """
    return render(
        "player.html",
        title=title(recordings),
        recordings=[_described(it) for it in recordings],
        data=player_data(recordings),
        script=player_script(),
        style=player_style(),
    )


def title(recordings: Sequence[Recording]) -> str:
    """What is seen, in a few words: what recordings differ in, then what they share."""
    if len({it.run for it in recordings}) == 1:
        return f"{' against '.join(it.condition for it in recordings)}, {recordings[0].run}"
    return " against ".join(f"{it.condition}, {it.run}" for it in recordings)


# --- a robot as data -----------------------------------------------------------------------------------------------


def quantum(body: Body) -> float:
    """To what the coordinates of a robot are rounded, u: a power of ten; off by half of it at most."""
    return 10.0 ** math.floor(math.log10(extent(body) / PARTS_OF_EXTENT))


def _robot(it: Recording) -> dict[str, Any]:
    body = it.body
    is_muscle = np.zeros(body.n_springs, dtype=bool)
    is_muscle[body.muscle_spring] = True
    return {
        "condition": it.condition,
        "run": it.run,
        "notes": it.notes,
        "ending": "diverged" if it.status == "diverged" else "ended",
        "length": body.body_length,
        "floor": it.floor,
        "center": body.center.tolist(),
        "springs": body.springs[~is_muscle].ravel().tolist(),
        "muscles": body.springs[body.muscle_spring].ravel().tolist(),
        "rest": body.rest_length[body.muscle_spring].tolist(),
        "cells": body.cells.ravel().tolist(),
        "coordinates": packed(it.times, it.positions, quantum(body)),
    }


def packed(times: Floats, positions: Floats, quantum: float) -> dict[str, Any]:
    """Positions as data.

    Parameters
    ----------
    times : (n_frames,)
        s; equally far apart but for the last.
    positions : (n_frames, n_nodes, 2)
        u.
    quantum : float
        u.

    Returns
    -------
    dict
        ``frames``, ``nodes``; ``interval`` between two frames and ``end``, the time of the last one, s; ``quantum``;
        ``planes``, the bytes of a number; and ``data``. Its numbers are those of each coordinate (x of node 0, y of
        node 0, x of node 1 ...) frame by frame.
    """
    whole = np.rint(positions / quantum).astype(np.int64)
    series = whole.reshape(len(whole), -1).T
    bytes_of = _bytes(_unsigned(np.diff(series, n=2, axis=1, prepend=np.zeros((len(series), 2), np.int64))))
    return {
        "frames": len(times),
        "nodes": positions.shape[1],
        "interval": float(times[1] - times[0]) if len(times) > 1 else 0.0,
        "end": float(times[-1]),
        "quantum": quantum,
        "planes": len(bytes_of),
        "data": base64.b64encode(zlib.compress(b"".join(bytes_of), 9)).decode(),
    }


def _unsigned(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """0, -1, 1, -2, 2 ... as 0, 1, 2, 3, 4 ...: numbers near 0 have no high bytes, whatever their sign."""
    return (numbers << 1) ^ (numbers >> 63)


def _bytes(numbers: NDArray[np.int64]) -> list[bytes]:
    """The low bytes of all numbers, then the next ones, as many as the largest needs."""
    count = max(1, -(-int(numbers.max()).bit_length() // 8))
    return [(numbers >> 8 * place & 0xFF).astype(np.uint8).tobytes() for place in range(count)]


# --- in words ------------------------------------------------------------------------------------------------------


def _described(it: Recording) -> dict[str, Any]:
    """What the page says of a recording besides what the player shows."""
    return {
        "condition": it.condition,
        "performance": "no score" if math.isnan(it.performance) else f"{it.performance:.2f}",
        "duration": f"{it.duration:g} s",
        "robot": robot_in_words(it.morphology),
        "rounding": f"{quantum(it.body) / 2:g} u of the {it.body.body_length:,.3g} u of a body length",
    }


def robot_in_words(morphology: Morphology) -> str:
    """The factors that are not those of the adult."""
    changed = [f"{name} × {factor:.3g}" for name, factor in vars(morphology).items() if factor != 1.0]
    return ", ".join(changed) or "the adult"
