"""`wobblesim stats`: the numbers of a study, each condition against a baseline."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wobblesim.commands.options import PLAIN_WIDTH, echo_json, json_option, plural, print_table, table

if TYPE_CHECKING:
    from wobblesim.analysis.comparison import Comparison
    from wobblesim.analysis.tables import Results

FILE = click.Path(dir_okay=False, path_type=Path)


@click.command("stats")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--baseline", metavar="ID", help="Condition to compare with.  [default: fixed, else the first]")
@click.option(
    "--condition",
    "conditions",
    metavar="ID",
    multiple=True,
    help="Compare only this one with the baseline; may be given again.  [default: all]",
)
@click.option(
    "--alpha",
    type=click.FloatRange(0.0, 1.0, min_open=True, max_open=True),
    default=0.01,
    show_default=True,
    help="Threshold of significance.",
)
@json_option
@click.option("--csv", metavar="FILE", type=FILE, help="Write all numbers as CSV, one row a condition.")
@click.option("--parquet", metavar="FILE", type=FILE, help="The same as Parquet, with units in the metadata.")
@click.option("--latex", metavar="FILE", type=FILE, help="Write the main numbers as a LaTeX tabular (booktabs).")
def command(
    folder: Path,
    baseline: str | None,
    conditions: tuple[str, ...],
    alpha: float,
    as_json: bool,
    csv: Path | None,
    parquet: Path | None,
    latex: Path | None,
) -> None:
    """Print what came out in DIR, and how each condition differs from a baseline, paired by seed.

    Means and medians with 99 % intervals; Shapiro-Wilk test of the differences, Wilcoxon's signed-rank test with and
    without Holm's correction, rank-biserial correlation, and the paired t test where the differences may be normal.
    Works while a sweep is writing to DIR: on the runs that are finished.

    \b
    Examples:
        wobblesim stats results/study
        wobblesim stats results/study --baseline size --condition mass --condition stiffness
        wobblesim stats results/study --json --csv numbers.csv --latex table.tex
    """  # noqa: D301 - click reads the backspace
    from wobblesim.analysis.comparison import compare
    from wobblesim.analysis.export import as_data
    from wobblesim.analysis.tables import load

    results = load(folder)
    found = compare(results, baseline, alpha, conditions or None)
    _write(found, results, csv, parquet, latex)
    if as_json:
        echo_json({"results": str(folder), **as_data(found)})
        return
    _print_conditions(found)
    _print_pairs(found)
    if found.notes:
        click.echo("\n" + "\n".join(found.notes))


def _write(found: Comparison, results: Results, csv: Path | None, parquet: Path | None, latex: Path | None) -> None:
    from wobblesim.analysis.export import write_csv, write_latex, write_parquet

    if csv:
        write_csv(found, csv)
    if parquet:
        kernels = {results.manifest.conditions[name]["kernel"] for name in found.conditions["condition"]}
        write_parquet(found, parquet, {"kernel": " ".join(sorted(kernels))})
    if latex:
        write_latex(found, latex)
    for path in filter(None, (csv, parquet, latex)):
        click.echo(f"written: {path}", err=True)


# --- tables --------------------------------------------------------------------------------------------------------

OF_CONDITIONS = """
mean, median: of the performance (best trial of the last epoch, body lengths), 99 % intervals: Student; exact, from 8 runs on
excluded: runs without a score, as every trial of the last epoch diverged
path: search distance up to the end of the wobble, and after it; 99 % interval (Student)
diverged, refined, limited: trials of each status, and in how many runs some diverged
"""  # noqa: E501 - lines of the output

OF_PAIRS = """
pairs: seeds with a score on both sides
difference: performance minus that of {baseline} with the same seed; 99 % intervals as above
effect: matched-pairs rank-biserial correlation, from -1 to +1; 99 % interval (Wilson)
Shapiro: p of the Shapiro-Wilk test that the differences are normal; t: p of the paired t test, where that is not below {alpha:g}
Wilcoxon: p of the signed-rank test, two-sided; Holm: the same, corrected for {family}; * below {alpha:g}
"""  # noqa: E501


def _print_conditions(found: Comparison) -> None:
    columns = [
        "condition", "runs", "excluded", "mean", "median", "path before", "path after", "diverged", "in runs",
        "refined", "limited",
    ]  # fmt: skip
    _print_whole(columns, [_condition_cells(row) for row in found.conditions.to_dict("records")])
    click.echo(OF_CONDITIONS.strip())


def _condition_cells(row: dict[str, Any]) -> list[str]:
    from rich.markup import escape

    from wobblesim.analysis.export import with_interval, with_width

    return [
        escape(row["condition"]),
        *(f"{row[name]:,}" for name in ("runs", "excluded")),
        with_width(row["mean"], row["half_width"]),
        escape(with_interval(row["median"], row["median_low"], row["median_high"])),
        *(with_width(row[name], row[f"{name}_half_width"], digits=2) for name in ("path_before", "path_after")),
        *(f"{row[name]:,}" for name in ("diverged", "diverged_runs", "refined", "limited")),
    ]


def _print_pairs(found: Comparison) -> None:
    if found.pairs.empty:
        click.echo("\none condition: there is nothing to compare")
        return
    columns = [
        f"against {found.baseline}", "pairs", "mean difference", "median difference", "effect", "Shapiro", "Wilcoxon",
        "Holm", "t",
    ]  # fmt: skip
    _print_whole(columns, [_pair_cells(row) for row in found.pairs.to_dict("records")])
    family = plural(int(found.pairs["p"].notna().sum()), "test")
    click.echo(OF_PAIRS.strip().format(baseline=found.baseline, family=family, alpha=found.alpha))


def _pair_cells(row: dict[str, Any]) -> list[str]:
    from rich.markup import escape

    from wobblesim.analysis.export import p_text, with_interval, with_width

    ends = row["median_difference_low"], row["median_difference_high"]
    return [
        escape(row["condition"]),
        f"{row['n_pairs']:,}",
        with_width(row["difference"], row["difference_half_width"], sign="+"),
        escape(with_interval(row["median_difference"], *ends, sign="+")),
        escape(with_interval(row["effect"], row["effect_low"], row["effect_high"], digits=2, sign="+")),
        p_text(row["shapiro_p"]),
        p_text(row["p"]),
        p_text(row["p_holm"]) + ("*" if row["significant"] else ""),
        p_text(row["t_p"]),
    ]


def _print_whole(columns: list[str], rows: list[list[str]]) -> None:
    """Print a table; where it is wider than the terminal, as several below one another, so that no number is cut."""
    from rich.console import Console

    console = Console()
    room = console.width if console.is_terminal else PLAIN_WIDTH
    widths = [max(map(len, column)) + 2 for column in zip(columns, *rows, strict=True)]
    for part in _fitting(widths, room - 2):
        print_table(table([columns[place] for place in part], [[row[place] for place in part] for row in rows]))


def _fitting(widths: list[int], room: int) -> list[list[int]]:
    """Columns by place, the first of all at the begin of each part, that together are no wider than the room."""
    parts = [[0]]
    for place in range(1, len(widths)):
        if len(parts[-1]) > 1 and sum(widths[it] for it in [*parts[-1], place]) > room:
            parts.append([0])
        parts[-1].append(place)
    return parts
