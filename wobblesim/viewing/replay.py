"""Which robots are worth watching, and a page or a film of them in one call."""

from __future__ import annotations

import hashlib
import html
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from wobblesim.analysis.statistics import baseline
from wobblesim.analysis.tables import Results, load
from wobblesim.study.errors import StoreError
from wobblesim.study.files import write_whole
from wobblesim.study.group import written_seeds
from wobblesim.study.manifest import RunKey
from wobblesim.viewing import animation
from wobblesim.viewing.player import player_page, title
from wobblesim.viewing.recording import FRAMES_PER_SECOND, Recording, check_condition, record

FILMS: dict[str, Callable[..., bytes]] = {".gif": animation.gif, ".mp4": animation.mp4}
"""What makes a film of recordings, by the end of its name."""

FOLDER = "replays"
"""In a results folder, where pages go."""

LONGEST_NAME = 60
"""Letters of a condition in the name of a file."""


@dataclass(frozen=True, eq=False, repr=False)
class Replay:
    """Recordings to watch; shows itself in a notebook. Made by `replay`.

    Attributes
    ----------
    recordings : tuple of Recording
        From top to bottom.
    """

    recordings: tuple[Recording, ...]

    @cached_property
    def html(self) -> str:
        """A page with a player, which needs no network."""
        return player_page(self.recordings)

    @property
    def name(self) -> str:
        """A name for a file, without its end."""
        conditions = "-against-".join(_short(it.condition) for it in self.recordings)
        numbers = dict.fromkeys(f"seed-{it.seed}_epoch-{it.epoch}" for it in self.recordings)
        return "_".join((conditions, *numbers))

    def save(self, path: str | Path, *, seconds: float | None = None, fps: float | None = None) -> Path:
        """Write a page (.html) or a film (.gif, .mp4): there is the whole new file, or what was there before.

        Parameters
        ----------
        path : path
        seconds : float, optional
            How much a film shows. By default 10 s of a GIF, 30 s of an MP4.
        fps : float, optional
            Frames a second of a film. By default 15 of a GIF, 30 of an MP4.

        Returns
        -------
        Path
            The same.

        Raises
        ------
        StoreError
            If the name has another end, or a film cannot be made here; `WriteError` if the system refuses to write.
        """
        path = Path(path)
        check_name(path)
        film = FILMS.get(path.suffix.lower())
        content = film(self.recordings, seconds, fps) if film else self.html.encode()
        write_whole(path, content)
        return path

    def __repr__(self) -> str:
        return f"<Replay of {title(self.recordings)}>"

    def _repr_html_(self) -> str:
        """The page in a frame of its own, as a notebook shows it; what is in it can reach nothing outside."""
        height = 420 + 150 * len(self.recordings)
        return (
            f'<iframe title="{html.escape(title(self.recordings))}" sandbox="allow-scripts" width="100%" '
            f'height="{height}" style="border: 0; max-width: 1100px" srcdoc="{html.escape(self.html)}"></iframe>'
        )


def _short(condition: str) -> str:
    """A condition as part of a name; a long one cut, with a hash by which it differs from others that begin alike."""
    if len(condition) <= LONGEST_NAME:
        return condition
    return f"{condition[: LONGEST_NAME - 9]}-{hashlib.sha256(condition.encode()).hexdigest()[:8]}"


def check_name(path: Path) -> None:
    """Refuse the name of a file that would be neither a page nor a film, or a film that cannot be made here.

    Raises
    ------
    StoreError
        If it is.
    """
    suffix = path.suffix.lower()
    if suffix != ".html" and suffix not in FILMS:
        raise StoreError(
            f"{path} does not end in .html, .gif or .mp4, which is what can be written; choose another name"
        )
    if suffix == ".mp4":
        animation.find_ffmpeg()


def replay(
    results: Results | str | Path,
    *,
    condition: str | None = None,
    seed: int | None = None,
    epoch: int | None = None,
    best: bool = False,
    pair: bool = False,
    seconds: float | None = None,
    frames_per_second: float = FRAMES_PER_SECOND,
) -> Replay:
    """Simulate stored behaviours again, to watch them.

    Parameters
    ----------
    results : Results, or path of a results folder
    condition, seed, best, pair
        Which runs, see `choose`.
    epoch : int, optional
        Whose best behaviour; the last epoch's if not given.
    seconds, frames_per_second
        As for `record`.

    Raises
    ------
    StoreError
        If there is no such run, or it cannot be simulated here.
    """
    results = results if isinstance(results, Results) else load(results)
    chosen = choose(results, condition, seed, best=best, pair=pair)
    seen = (record(results, *run, epoch, frames_per_second=frames_per_second, seconds=seconds) for run in chosen)
    return Replay(tuple(seen))


# --- which runs ----------------------------------------------------------------------------------------------------


def choose(
    results: Results, condition: str | None = None, seed: int | None = None, *, best: bool = False, pair: bool = False
) -> list[RunKey]:
    """The runs to watch.

    Parameters
    ----------
    results : Results
    condition : str, optional
    seed : int, optional
    best : bool
        The one run with the highest performance, of those with the condition and the seed if these are given.
    pair : bool
        Two runs with the same seed: of the `baseline`, and of the condition, which is the other one with the highest
        mean performance if not given. The seed, if not given, is that in which they differ as they do in the middle:
        whose difference in performance is nearest to the median one.

    Returns
    -------
    list of (str, int)
        Conditions and seeds. With neither `best` nor `pair`, a pair if the condition is not given and there is one
        named ``fixed`` to compare with, else the best.

    Raises
    ------
    StoreError
        If there is nothing to choose from.
    ValueError
        If both the best and a pair are asked for.
    """
    if best and pair:
        raise ValueError("choose either the best or a pair")
    if condition is not None and (condition, seed) not in results.manifest.failures:
        check_condition(results, condition)
    compares = condition is None and "fixed" in results.conditions and len(results.conditions) > 1
    if pair or (compares and not best):
        return _pair(results, condition, seed)
    if condition is not None and seed is not None:
        return [(condition, seed)]
    return [_best(results, condition, seed)]


def _scores(results: Results) -> pd.DataFrame:
    """Performance by seed (rows) and condition; NaN where there is none."""
    runs = results.runs("condition", "seed", "performance")
    return runs.pivot(index="seed", columns="condition", values="performance")


def _best(results: Results, condition: str | None, seed: int | None) -> RunKey:
    scores = _scores(results)
    if seed is not None and seed not in scores.index:
        raise StoreError(
            f"{results.folder} has no run with seed {seed}; choose among {written_seeds(scores.index.tolist())}"
        )
    mine = scores.loc[
        scores.index if seed is None else [seed], results.conditions if condition is None else [condition]
    ]
    values = mine.to_numpy()
    if np.isnan(values).all():
        raise StoreError(
            f"no such run of {results.folder} has a score, for all trials of its last epoch diverged; "
            "name one with --condition, --seed and --epoch to watch how"
        )
    row, column = np.unravel_index(np.nanargmax(values), values.shape)
    return str(mine.columns[column]), int(mine.index[row])


def _pair(results: Results, condition: str | None, seed: int | None) -> list[RunKey]:
    scores, reference = _scores(results), baseline(results.conditions)
    other = condition or _best_mean(results, scores, reference)
    if other == reference:
        raise StoreError(
            f"{reference} is what others are compared with, and no pair with itself; choose another condition or --best"
        )
    if seed is None:
        seed = _middle_seed(results, scores[other] - scores[reference], reference, other)
    return [(reference, seed), (other, seed)]


def _best_mean(results: Results, scores: pd.DataFrame, reference: str) -> str:
    others = scores.drop(columns=reference).mean()
    if len(others) == 0:
        raise StoreError(
            f"{results.folder} has the condition {reference} only, and nothing to pair it with; use --best"
        )
    return str(others.index[0] if others.isna().all() else others.idxmax())


def _middle_seed(results: Results, difference: pd.Series, reference: str, other: str) -> int:
    """The seed whose difference is nearest to the median, the first of several."""
    known = difference.dropna()
    if len(known) == 0:
        raise StoreError(
            f"no seed of {results.folder} has a score both in {reference} and in {other}; choose one run with "
            "--condition and --seed"
        )
    return int((known - known.median()).abs().idxmin())
