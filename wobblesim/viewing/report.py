"""What came out of a study as one page: numbers, figures, robots to watch, and where all of it comes from.

The page is one file that needs no network. Its policy (Content-Security-Policy) allows the two scripts of the package
by their hashes and nothing else, so that a name in a study cannot become one.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import yaml

from wobblesim.analysis.comparison import Comparison, compare
from wobblesim.analysis.errors import FigureError
from wobblesim.analysis.export import COLUMNS, flat, p_text, with_interval, with_width
from wobblesim.analysis.figures.registry import FIGURES, Choice, draw
from wobblesim.analysis.figures.style import Drawing, as_bytes, performance_label
from wobblesim.analysis.tables import Results, load, remembered
from wobblesim.study.errors import StoreError
from wobblesim.study.files import read_about, write_whole
from wobblesim.study.manifest import Manifest, RunKey
from wobblesim.study.provenance import version_of
from wobblesim.study.schema import PARAMETERS
from wobblesim.study.store import CONFIG
from wobblesim.viewing.page import asset, render
from wobblesim.viewing.player import player_data, player_script, player_style, title
from wobblesim.viewing.recording import Recording, record
from wobblesim.viewing.replay import choose

NAME = "report.html"
"""In a results folder, where the page goes."""

SECTIONS = {
    "performance": ("boxes", "figure-3a", "figure-3b", "figure-3c", "pairs", "heat-map"),
    "learning": ("figure-2b", "figure-2a"),
    "search": ("figure-4a", "figure-4b", "exploration"),
    "other-bodies": ("generalisation",),
}
"""Figures by the section that they stand in."""

SIMULATED = ("other-bodies",)
"""Sections whose figures take simulation."""

LARGE = 200_000
"""Bytes of an SVG above which the PNG is taken, if that is smaller."""

MOST_ROWS = 10
"""Rows of the table behind a figure that are on the page."""

LARGEST_CSV = 100_000
"""Bytes of a table that are in the page to be saved as a file."""

LARGEST_TEXT = 200_000
"""Bytes of the configuration that are shown."""

SECONDS = 60.0
"""Of a trial that a player shows, at most."""

LARGEST_ROBOT = 400_000
"""Bytes of a recording in the page; that of a larger robot is cut to fit."""

MOST_ROBOTS = 4
"""Best robots on one clock."""

MOST_MISSING = 200
"""Runs that make no pair, or came to no result, that are listed."""

Tell = Callable[[str], None]


@dataclass(frozen=True, eq=False, repr=False)
class Report:
    """A page on a study; shows itself in a notebook. Made by `report`.

    Attributes
    ----------
    html : str
        The page.
    headline : str
        The main result, as the page says it.
    figures : tuple of str
        Names of the figures in it.
    left_out : dict of str to str
        By the name of a figure or player that is not in it, why.
    """

    html: str = field(repr=False)
    headline: str
    figures: tuple[str, ...]
    left_out: Mapping[str, str]

    def save(self, path: str | Path) -> Path:
        """Write the page: there is the whole new file, or what was there before.

        Returns
        -------
        Path
            The same.

        Raises
        ------
        WriteError
            If the system refuses to write.
        """
        path = Path(path)
        write_whole(path, self.html.encode())
        return path

    def __repr__(self) -> str:
        return f"<Report: {self.headline}>"

    def _repr_html_(self) -> str:
        """The page in a frame of its own, as a notebook shows it; what is in it can reach nothing outside."""
        return (
            f'<iframe title="Report" sandbox="allow-scripts allow-downloads" width="100%" height="800" '
            f'style="border: 0" srcdoc="{html.escape(self.html)}"></iframe>'
        )


def report(
    results: Results | str | Path,
    *,
    baseline: str | None = None,
    simulate: bool = True,
    tell: Tell | None = None,
) -> Report:
    """Make a page on a study, also on one that is not finished.

    The same results make the same bytes.

    Parameters
    ----------
    results : Results, or path of a results folder
    baseline : str, optional
        Condition that others are compared with; without it, ``fixed`` if there is such a condition, else the first.
    simulate : bool
        Whether what has to be simulated is in it: the robots to watch, and the learnt gaits on other bodies.
    tell : callable, optional
        Called with what is being made, in a few words.

    Raises
    ------
    StoreError
        If there is no finished run, or none of the baseline.
    """
    results = remembered(results if isinstance(results, Results) else load(results))
    tell = tell or (lambda _: None)
    tell("statistics")
    found = compare(results, baseline)
    sections = SECTIONS if simulate else SECTIONS | dict.fromkeys(SIMULATED, ())
    figures = _figures(results, [name for names in sections.values() for name in names], found.baseline, tell)
    robots = _players(results, found, tell) if simulate else []
    headline = headline_of(found, performance_label(results))
    page = render(
        "report.html",
        study=_study_name(results),
        headline=headline,
        policy=_policy(),
        style=f"{player_style()}\n{asset('report.css')}",
        scripts=(player_script(), asset("report.js")),
        **_standing(results, found),
        settings=_settings(results),
        sections={name: [it for it in figures if it.name in names] for name, names in sections.items()},
        statistics=_statistics(found),
        players=robots,
        is_simulated=simulate,
        provenance=_provenance(results),
    )
    left_out = {it.name: it.why for it in (*figures, *robots) if it.why}
    return Report(page, " ".join(headline), tuple(it.name for it in figures if not it.why), left_out)


def _policy() -> str:
    """What the page may do: run these two scripts, show what it holds; nothing from anywhere else."""
    hashes = (hashlib.sha256(script.encode()).digest() for script in (player_script(), asset("report.js")))
    scripts = " ".join(f"'sha256-{base64.b64encode(it).decode()}'" for it in hashes)
    return (
        f"default-src 'none'; script-src {scripts}; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
        "form-action 'none'"
    )


# --- the main result -----------------------------------------------------------------------------------------------


def headline_of(found: Comparison, unit: str) -> tuple[str, ...]:
    """Say the main result in a sentence; of more than two conditions in two, what holds of all of them first.

    Parameters
    ----------
    found : Comparison
    unit : str
        Of a performance: ``body lengths in 60 s``.
    """
    scored = found.conditions.dropna(subset="mean").set_index("condition")
    if scored.empty:
        return ("No run has a score: in each, all trials of the last epoch diverged.",)
    best = best_other(found)
    if best is None:
        top = scored.loc[scored["mean"].idxmax()]
        runs = _plural(int(top["runs"] - top["excluded"]), "run")
        return (f"{top.name}: {with_width(top['mean'], top['half_width'], 2)} {unit} ({runs}).",)
    pair = found.pairs.set_index("condition").loc[best]
    more = f"{_more(pair['difference'])} {found.baseline}"
    tested = f"{_plural(int(pair['n_pairs']), 'pair')}, {_in_words(pair, found)}"
    of_best = f"{best}: {scored.loc[best, 'mean']:.2f} {unit}, {more} ({tested})."
    return (of_best,) if len(found.pairs) < 2 else (_of_all(found), f"Highest mean: {of_best}")


def _more(difference: float) -> str:
    """By how much: with two digits behind the point, or with two digits in all where that would be nothing."""
    size = abs(difference)
    if not size:
        return "as much as"
    number = f"{size:.2f}" if size >= 0.005 else f"{size:.2g}"
    return f"{number} {'more' if difference > 0 else 'less'} than"


def best_other(found: Comparison) -> str | None:
    """The condition with the highest mean among those that make a pair with the baseline."""
    paired = set(found.pairs.loc[found.pairs["n_pairs"] > 0, "condition"])
    means = found.conditions[found.conditions["condition"].isin(paired)].set_index("condition")["mean"]
    return None if means.empty else str(means.idxmax())


def _in_words(pair: pd.Series, found: Comparison) -> str:
    """What the test says, corrected for its family."""
    tests = int(found.pairs["p"].notna().sum())
    corrected = f", Holm-corrected for {tests:,} tests" if tests > 1 else ""
    p = p_text(pair["p_holm"])
    equal = p if p.startswith("<") else f"= {p}"
    return f"Wilcoxon p {equal}{corrected}, {'' if pair['significant'] else 'not '}significant at {found.alpha:g}"


def _of_all(found: Comparison) -> str:
    """How many conditions differ from the baseline."""
    differ = found.pairs[found.pairs["significant"]]
    better, level = int((differ["difference"] > 0).sum()), f"(Wilcoxon, Holm-corrected, p < {found.alpha:g})"
    if differ.empty:
        return f"None of {len(found.pairs):,} conditions differs significantly from {found.baseline} {level}."
    return (
        f"Of {len(found.pairs):,} conditions, {better:,} did significantly better than {found.baseline}, "
        f"{len(differ) - better:,} worse {level}."
    )


# --- tables --------------------------------------------------------------------------------------------------------


class Cell(NamedTuple):
    """What is read, and the whole number behind it, for scripts."""

    text: str
    value: str = ""
    name: str = ""


@dataclass(frozen=True)
class Table:
    """A table of the page; the first cell of a row is its name."""

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    words: bool = False


def _cell(row: Mapping[Any, Any], name: str, text: str | None = None) -> Cell:
    value = row[name]
    return Cell(f"{value:,}" if text is None else text, repr(value), name)


def _mean(row: Mapping[Any, Any], name: str, half_width: str, digits: int = 3, sign: str = "") -> Cell:
    return _cell(row, name, with_width(row[name], row[half_width], digits, sign))


def _interval(row: Mapping[Any, Any], name: str, digits: int = 3, sign: str = "") -> Cell:
    return _cell(row, name, with_interval(row[name], row[f"{name}_low"], row[f"{name}_high"], digits, sign))


def _statistics(found: Comparison) -> dict[str, Any]:
    missing = [[Cell(it.condition), Cell(f"{it.seed}"), Cell(it.why)] for it in found.missing.itertuples()]
    return {
        "baseline": found.baseline,
        "alpha": found.alpha,
        "conditions": _of_conditions(found),
        "pairs": _of_pairs(found),
        "trials": _of_trials(found),
        "missing": Table("Seeds that make no pair", ("condition", "seed", "why"), missing[:MOST_MISSING], words=True),
        "n_missing": len(missing),
        "notes": found.notes,
        "csv": _csv_link(flat(found)),
        "columns": [(name, column.meaning, column.unit) for name, column in COLUMNS.items()],
    }


def _of_conditions(found: Comparison) -> Table:
    rows = [
        [
            _name_of(row, found),
            _cell(row, "runs"),
            _mean(row, "mean", "half_width"),
            _interval(row, "median"),
            *(_mean(row, name, f"{name}_half_width", 2) for name in ("path_before", "path_after")),
        ]
        for row in found.conditions.to_dict("records")
    ]
    columns = ("condition", "runs", "mean", "median", "path before", "path after")
    return Table("Each condition: performance in body lengths, and search distance", columns, rows)


def _name_of(row: Mapping[Any, Any], found: Comparison) -> Cell:
    return Cell(str(row["condition"]), "baseline" if row["condition"] == found.baseline else "")


def _of_pairs(found: Comparison) -> Table:
    rows = [
        [
            Cell(row["condition"]),
            _cell(row, "n_pairs"),
            _cell(row, "missing"),
            _mean(row, "difference", "difference_half_width", sign="+"),
            _interval(row, "median_difference", sign="+"),
            _interval(row, "effect", 2, "+"),
            _cell(row, "shapiro_p", p_text(row["shapiro_p"])),
            _cell(row, "p", p_text(row["p"])),
            _cell(row, "p_holm", p_text(row["p_holm"]) + ("*" if row["significant"] else "")),
            _cell(row, "t_p", p_text(row["t_p"])),
        ]
        for row in found.pairs.to_dict("records")
    ]
    columns = (
        "condition", "pairs", "missing", "mean difference", "median difference", "effect", "Shapiro p", "Wilcoxon p",
        "Holm p", "t p",
    )  # fmt: skip
    return Table(f"Each condition against {found.baseline}, paired by seed", columns, rows)


def _of_trials(found: Comparison) -> Table:
    rows = [
        [
            _name_of(row, found),
            *(_cell(row, name) for name in ("runs", "excluded", "diverged_runs", "trials")),
            *(_cell(row, name, _share(row[name], row["trials"])) for name in ("diverged", "refined", "limited")),
        ]
        for row in found.conditions.to_dict("records")
    ]
    columns = (
        "condition", "runs", "excluded runs", "runs with a diverged trial", "trials", "diverged", "refined", "limited"
    )  # fmt: skip
    return Table("Trials that did not go as planned, of each condition", columns, rows)


def _share(count: int, of: int) -> str:
    """A number, and which part of all it is."""
    return f"{count:,} ({100 * count / of:.2g} %)" if count else "0"


def _of_frame(frame: pd.DataFrame) -> Table:
    """The first rows of the table behind a figure."""
    rows = [[Cell(_written(value)) for value in row] for row in frame.head(MOST_ROWS).itertuples(index=False)]
    return Table("The first rows of the table behind the figure", list(map(str, frame.columns)), rows)


def _written(value: object) -> str:
    """A value as it is read; a dash for none."""
    if value is None or value is pd.NA or value != value:
        return "–"
    if isinstance(value, bool) or type(value).__name__ == "bool":
        return "yes" if value else "no"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


class Link(NamedTuple):
    """A file within the page."""

    address: str
    bytes: str


def _csv_link(frame: pd.DataFrame) -> Link | None:
    """A table as a file to be saved, if it is small."""
    content = frame.to_csv(index=False, lineterminator="\n").encode()
    if len(content) > LARGEST_CSV:
        return None
    return Link(_data_address("text/csv", content), f"{max(1, round(len(content) / 1e3)):,} kB")


def _data_address(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


# --- what was run --------------------------------------------------------------------------------------------------


def _standing(results: Results, found: Comparison) -> dict[str, Any]:
    """How far the study is, and what it consists of."""
    manifest = results.manifest
    wanted = manifest.wanted()
    n_wanted, done = sum(map(len, wanted.values())), len(manifest.runs)
    return {
        "tiles": _tiles(found, n_wanted, done),
        "missing": n_wanted - done,
        "raised": [(*key, _last_line(why)) for key, why in list(manifest.failures.items())[:MOST_MISSING]],
        "unreadable": [_without_folder(results, line) for line in manifest.unreadable],
        "design": _design(results, wanted),
        "unit": performance_label(results),
    }


def _tiles(found: Comparison, wanted: int, done: int) -> list[tuple[str, str, str]]:
    """Name, number and what it is, of what is seen first."""
    total = found.conditions[["excluded", "trials", "diverged"]].sum()
    return [
        ("finished", f"{done:,} of {wanted:,}", "runs finished"),
        ("excluded", f"{total['excluded']:,}", "runs without a score"),
        ("trials", f"{total['trials']:,}", "trials simulated"),
        ("diverged", f"{total['diverged']:,}", "trials diverged"),
    ]


def _last_line(why: str) -> str:
    return why.strip().rpartition("\n")[-1]


def _design(results: Results, wanted: Mapping[str, set[int]]) -> str:
    """Conditions x seeds x epochs x trials, in words."""
    runs = results.runs("learning.epochs", "learning.population", "trial.duration")
    seeds, epochs, population, duration = (
        _span(values)
        for values in (
            map(len, wanted.values()), *(runs[name] for name in runs.columns),
        )
    )  # fmt: skip
    return (
        f"{_plural(len(wanted), 'condition')} × {seeds} {_noun(seeds, 'seed')} × {epochs} {_noun(epochs, 'epoch')} "
        f"× {population} {_noun(population, 'trial')} of {duration} s"
    )


def _span(values: Iterable[Any]) -> str:
    """The one value that all have, or the least and the largest."""
    known = sorted(set(values))
    least, largest = (f"{value:,.6g}" for value in (known[0], known[-1]))
    return least if least == largest else f"{least} to {largest}"


def _noun(number: str, noun: str) -> str:
    return noun if number == "1" else f"{noun}s"


def _plural(count: int, noun: str) -> str:
    return f"{count:,} {_noun(str(count), noun)}"


def _settings(results: Results) -> dict[str, Any]:
    """The settings that differ between conditions as a table, and those that do not."""
    names = [name for name in PARAMETERS if name != "robot.digest"]
    runs = results.runs("condition", *names).drop_duplicates("condition")
    vary = [name for name in names if runs[name].nunique(dropna=False) > 1]
    rows = [
        [Cell(str(row["condition"])), *(Cell(_written(row[name]), name=name) for name in vary)]
        for row in runs.to_dict("records")
    ]
    first = runs.iloc[0]
    same = [[Cell(name), Cell(_written(first[name]))] for name in names if name not in vary]
    return {
        "vary": Table("Settings that differ between the conditions", ("condition", *vary), rows) if vary else None,
        "same": Table("Settings that all conditions share", ("setting", "value"), same, words=True),
    }


# --- figures -------------------------------------------------------------------------------------------------------


class Figure(NamedTuple):
    """A figure of the page, or why it is not there."""

    name: str
    says: str
    why: str = ""
    address: str = ""
    width: int = 0
    height: int = 0
    table: Table | None = None
    rows: int = 0
    csv: Link | None = None


def _figures(results: Results, names: Sequence[str], baseline: str, tell: Tell) -> list[Figure]:
    made, choice = [], Choice(baseline=baseline)
    for name in names:
        tell(name)
        says = FIGURES[name].says
        try:
            made.append(_shown(name, says, draw(name, results, choice)))
        except (FigureError, StoreError) as error:
            made.append(Figure(name, says, why=_without_folder(results, str(error))))
    return made


def _shown(name: str, says: str, drawing: Drawing) -> Figure:
    kind, content = _picture(drawing)
    width, height = (round(96 * inches) for inches in drawing.figure.get_size_inches())
    address = _data_address(kind, content)
    table, csv = _of_frame(drawing.table), _csv_link(drawing.table)
    return Figure(name, says, "", address, width, height, table, len(drawing.table), csv)


def _picture(drawing: Drawing) -> tuple[str, bytes]:
    """As SVG, or as PNG where that is large and the PNG is not."""
    svg = as_bytes(drawing.figure, "svg")
    if len(svg) > LARGE and len(png := as_bytes(drawing.figure, "png")) < len(svg):
        return "image/png", png
    return "image/svg+xml", svg


# --- robots to watch -----------------------------------------------------------------------------------------------


class Player(NamedTuple):
    """Robots on one clock, or why they are not there."""

    name: str
    title: str
    about: str = ""
    data: str = ""
    why: str = ""


def _players(results: Results, found: Comparison, tell: Tell) -> list[Player]:
    """The pair first, then the best robots, unless those are the same runs."""
    scores = results.runs("condition", "seed", "performance").pivot(
        index="seed", columns="condition", values="performance"
    )
    pair, best = _pair(scores, found), _best(results, found)
    made = []
    if pair:
        about = "the same seed: both began with the same behaviours; of all seeds, the difference is nearest its median"
        made.append(_player(results, "player-pair", pair, about, tell))
    if not pair or set(best) - set(pair):
        about = "the run with the highest performance of each condition"
        if len(best) < found.conditions["mean"].notna().sum():
            about = (
                f"the run with the highest performance of {found.baseline} and of the conditions with the highest means"
            )
        made.append(_player(results, "player-best", best, about, tell))
    return made


def _pair(scores: pd.DataFrame, found: Comparison) -> list[RunKey]:
    """Baseline and best other condition, of the seed whose difference is nearest the median."""
    other = best_other(found)
    if other is None:
        return []
    difference = (scores[other] - scores[found.baseline]).dropna()
    seed = int((difference - difference.median()).abs().idxmin())
    return [(found.baseline, seed), (other, seed)]


def _best(results: Results, found: Comparison) -> list[RunKey]:
    """The best runs of the baseline and of those with the highest means, as the study orders them."""
    means = found.conditions.dropna(subset="mean").set_index("condition")["mean"]
    others = means.drop(found.baseline, errors="ignore").nlargest(MOST_ROBOTS - (found.baseline in means)).index
    return [choose(results, name, best=True)[0] for name in means.index if name in {found.baseline, *others}]


def _player(results: Results, name: str, runs: Sequence[RunKey], about: str, tell: Tell) -> Player:
    tell(f"robots: {', '.join(f'{condition}, seed {seed}' for condition, seed in runs) or 'none'}")
    if not runs:
        return Player(name, "The best robots", why="No run has a score, so that there is no best robot to watch.")
    try:
        recordings = [_recorded(results, *run) for run in runs]
    except StoreError as error:
        return Player(name, "Robots", why=_without_folder(results, str(error)))
    if name == "player-pair":
        heading = title(recordings)
    else:
        heading = "The best robots on one clock" if len(runs) > 1 else "The best robot"
    return Player(name, heading, about, player_data(recordings))


def _recorded(results: Results, condition: str, seed: int) -> Recording:
    """A recording that fits: of a robot with very many nodes, as many seconds as do."""
    whole = record(results, condition, seed, seconds=SECONDS)
    size = len(player_data([whole]))
    if size <= LARGEST_ROBOT:
        return whole
    return record(results, condition, seed, seconds=float(whole.times[-1]) * LARGEST_ROBOT / size)


# --- where it comes from -------------------------------------------------------------------------------------------

SOURCES = {
    "version": "wobblesim",
    "git": "commit",
    "kernel": "kernel",
    "python": "Python",
    **{name: name for name in ("numba", "llvmlite", "numpy", "pyarrow", "libc")},
    "platform": "system",
    "cpu": "processor",
    "target": "compiled for",
    "features": "vector unit",
}
"""What the files say of what computed them, and what it is called."""


def _provenance(results: Results) -> dict[str, Any]:
    manifest, place = results.manifest, _folder_name(results)
    files = manifest.every_file().values()
    config = _config(results)
    return {
        "sources": _sources(results),
        "folder": place,
        "files": f"{len(files):,}",
        "bytes": _size(sum(file.bytes for file in files)),
        "runs": f"{len(manifest.runs):,}",
        "config": config,
        "rerun": _rerun_command(manifest, place),
        "sweep": f"wobblesim sweep {shlex.quote(f'{place}/{CONFIG}')} --out again" if config else "",
        "made_by": version_of("wobblesim"),
    }


def _size(count: int) -> str:
    return f"{count / 1e6:,.1f} MB" if count >= 1e6 else f"{count / 1e3:,.1f} kB"


def _rerun_command(manifest: Manifest, place: str) -> str:
    """The command that repeats the first run, as an example."""
    (_, seed), run = next(iter(manifest.runs.items()))
    file = run.files.get("epochs") or run.files["runs"]
    return f"wobblesim rerun {shlex.quote(f'{place}/{file.path}')} --seed {seed}"


def _sources(results: Results) -> Table:
    """Each thing that computed a run, as its file says; with the number of runs where there are several of a kind."""
    counted = {name: Counter[str]() for name in SOURCES}
    for file in results.manifest.files("runs"):
        for source, runs in _told(results.folder / file.path, file.rows):
            for name in SOURCES:
                counted[name][source.get(name) or "–"] += runs
    rows = [[Cell(SOURCES[name]), Cell(_counted(counts), name=name)] for name, counts in counted.items()]
    return Table("What computed the runs", ("", "as stored"), rows, words=True)


def _told(path: Path, rows: int) -> list[tuple[Mapping[str, Any], int]]:
    """What computed the runs of a file, and how many of them; a compacted one may have several origins."""
    about = read_about(path)
    if "sources" not in about:
        return [(about, rows)]
    return [({**about, **source}, len(source["seeds"])) for source in json.loads(about["sources"])]


def _counted(counts: Counter[str]) -> str:
    if len(counts) == 1:
        return next(iter(counts))
    return "; ".join(f"{what} ({_plural(runs, 'run')})" for what, runs in counts.most_common())


def _config(results: Results) -> str:
    """The text of the resolved configuration; empty if it is not there."""
    try:
        text = (results.folder / CONFIG).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return text if len(text) <= LARGEST_TEXT else f"{text[:LARGEST_TEXT]}\n... ({_size(len(text))} in all)"


def _study_name(results: Results) -> str:
    """As the configuration names it; without one, that of the folder."""
    try:
        name = yaml.safe_load(_config(results))["name"]
    except (yaml.YAMLError, KeyError, TypeError, RecursionError):
        name = None
    return str(name) if name else _folder_name(results)


def _folder_name(results: Results) -> str:
    """The folder without where it lies: a page may be passed on."""
    return results.folder.resolve().name or "results"


def _without_folder(results: Results, text: str) -> str:
    """A message without where the folder lies."""
    for place in dict.fromkeys((str(results.folder.resolve()), str(results.folder))):
        text = text.replace(place, _folder_name(results)) if place != "." else text
    return text
