"""A comparison as one flat table: CSV, Parquet with the meaning of each column, LaTeX, and data for JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from wobblesim.analysis.comparison import Comparison, ranges
from wobblesim.analysis.statistics import CONFIDENCE
from wobblesim.study.files import write_atomically
from wobblesim.study.provenance import git_state, version_of

LENGTHS, DISTANCE, RUNS, TRIALS, SEEDS, NONE = "body lengths", "1 (genotype)", "runs", "trials", "seeds", "1"


class Column(NamedTuple):
    """What a number is, and in which unit."""

    unit: str
    meaning: str


_OF_MEAN = "half width of its 99 % interval (Student)"
_OF_EFFECT = "of the 99 % interval (Wilson) of the effect"

COLUMNS = {
    "condition": Column("", "its id"),
    "runs": Column(RUNS, "finished runs"),
    "excluded": Column(RUNS, "of them without a score: every trial of the last epoch diverged"),
    "mean": Column(LENGTHS, "mean performance: best trial of the last epoch"),
    "half_width": Column(LENGTHS, _OF_MEAN),
    "median": Column(LENGTHS, "median performance"),
    "median_low": Column(LENGTHS, "lower end of the exact 99 % interval of the median"),
    "median_high": Column(LENGTHS, "upper end of the exact 99 % interval of the median"),
    "path_before": Column(DISTANCE, "mean search distance up to the end of the wobble"),
    "path_before_half_width": Column(DISTANCE, _OF_MEAN),
    "path_after": Column(DISTANCE, "mean search distance after the end of the wobble"),
    "path_after_half_width": Column(DISTANCE, _OF_MEAN),
    "trials": Column(TRIALS, "trials of all runs"),
    "diverged": Column(TRIALS, "of them diverged: no score"),
    "refined": Column(TRIALS, "of them within the trusted bounds only with a smaller step"),
    "limited": Column(TRIALS, "of them cut by a limiter"),
    "diverged_runs": Column(RUNS, "runs with a trial that diverged"),
    "baseline": Column("", "condition that is compared with"),
    "alpha": Column(NONE, "threshold of significance"),
    "n_pairs": Column(SEEDS, "seeds with a score on both sides"),
    "missing": Column(SEEDS, "seeds without a score on one side or both"),
    "missing_seeds": Column("", "which seeds these are"),
    "difference": Column(LENGTHS, "mean of performance minus that of the baseline with the same seed"),
    "difference_half_width": Column(LENGTHS, _OF_MEAN),
    "median_difference": Column(LENGTHS, "median of these differences"),
    "median_difference_low": Column(LENGTHS, "lower end of its exact 99 % interval"),
    "median_difference_high": Column(LENGTHS, "upper end of its exact 99 % interval"),
    "effect": Column(NONE, "matched-pairs rank-biserial correlation"),
    "effect_low": Column(NONE, f"lower end {_OF_EFFECT}"),
    "effect_high": Column(NONE, f"upper end {_OF_EFFECT}"),
    "shapiro_w": Column(NONE, "W of the Shapiro-Wilk test of the differences"),
    "shapiro_p": Column(NONE, "its p"),
    "normal": Column("", "whether shapiro_p is not below alpha"),
    "wilcoxon": Column(NONE, "smaller sum of the signed ranks of the differences"),
    "p": Column(NONE, "two-sided p of Wilcoxon's signed-rank test"),
    "p_holm": Column(NONE, "the same, Holm-corrected over all conditions that are compared"),
    "significant": Column("", "whether p_holm is below alpha"),
    "t": Column(NONE, "paired t, where normal"),
    "t_p": Column(NONE, "its two-sided p"),
}
"""Columns of the flat table, in order."""


def flat(comparison: Comparison) -> pd.DataFrame:
    """One row a condition with all its numbers; those of a comparison are missing in the row of the baseline."""
    types = {"n_pairs": "Int64", "missing": "Int64", "normal": "boolean", "significant": "boolean"}
    pairs = comparison.pairs.astype(types).set_index("condition")
    frame = comparison.conditions.join(pairs, on="condition")
    missing = comparison.missing.groupby("condition")["seed"].agg(ranges).astype("str")
    frame["missing_seeds"] = frame["condition"].map(missing).astype("str").where(frame["missing"].fillna(0) > 0, "")
    frame["baseline"], frame["alpha"] = comparison.baseline, comparison.alpha
    return frame[list(COLUMNS)]


def as_data(comparison: Comparison) -> dict[str, Any]:
    """All of a comparison as plain data, for JSON."""
    rows: list[dict[str, Any]] = comparison.pairs.to_dict("records")
    for row in rows:
        mine = comparison.missing[comparison.missing["condition"] == row["condition"]]
        row["missing_seeds"] = mine[["seed", "why"]].to_dict("records")
    return {
        "baseline": comparison.baseline,
        "alpha": comparison.alpha,
        "confidence": CONFIDENCE,
        "conditions": comparison.conditions.to_dict("records"),
        "pairs": rows,
        "notes": list(comparison.notes),
    }


# --- files ---------------------------------------------------------------------------------------------------------


def write_csv(comparison: Comparison, path: Path) -> None:
    """Write the flat table as CSV; what is missing is empty, and every number comes back bit for bit.

    Raises
    ------
    WriteError
        If the system refuses.
    """
    text = flat(comparison).to_csv(index=False, lineterminator="\n")
    write_atomically(path, path.parent, text.encode())


def write_parquet(comparison: Comparison, path: Path, about: Mapping[str, str] | None = None) -> None:
    """Write the flat table as Parquet, with unit and meaning of each column in the metadata of the column.

    The metadata of the file say, under names that begin with ``wobblesim.``, what it is of, which versions made it,
    the notes of the comparison, and what `about` adds.

    Raises
    ------
    WriteError
        If the system refuses.
    """
    table = pa.Table.from_pandas(flat(comparison), preserve_index=False)
    fields = [field.with_metadata(COLUMNS[field.name]._asdict()) for field in table.schema]
    told = {f"wobblesim.{name}": value for name, value in {**_about(comparison), **(about or {})}.items()}
    schema = pa.schema(fields, metadata={**(table.schema.metadata or {}), **told})
    sink = pa.BufferOutputStream()
    pq.write_table(table.cast(schema), sink, compression="zstd", write_page_checksum=True)
    write_atomically(path, path.parent, sink.getvalue())


def _about(comparison: Comparison) -> dict[str, str]:
    return {
        "table": "statistics",
        "baseline": comparison.baseline,
        "alpha": repr(comparison.alpha),
        "confidence": repr(CONFIDENCE),
        "notes": json.dumps(comparison.notes),
        "git": git_state(),
        "version": version_of("wobblesim"),
        **{package: version_of(package) for package in ("numpy", "pandas", "pyarrow", "scipy")},
    }


def write_latex(comparison: Comparison, path: Path) -> None:
    r"""Write a ``tabular`` for ``\input``, of the packages booktabs only; ids of conditions are escaped.

    Raises
    ------
    WriteError
        If the system refuses.
    """
    write_atomically(path, path.parent, as_latex(comparison).encode())


# --- words for numbers ---------------------------------------------------------------------------------------------

LEAST = 0.0001
"""Smallest p that is told by its digits."""


def p_text(p: float) -> str:
    """A p-value to three digits; a dash if there is none."""
    if p != p:
        return "–"
    return f"< {LEAST}" if p < LEAST else f"{p:#.3g}"


def with_width(value: float, half_width: float, digits: int = 3, sign: str = "") -> str:
    """A number ± half width; without the latter if there is none, a dash if there is neither."""
    if value != value:
        return "–"
    # The no-break space keeps ± with its number in a narrow terminal.
    width = f" ±\N{NO-BREAK SPACE}{half_width:.{digits}f}" if half_width == half_width else ""
    return f"{value:{sign}.{digits}f}{width}"


def with_interval(value: float, low: float, high: float, digits: int = 3, sign: str = "") -> str:
    """A number and its interval in brackets; without the latter if there is none, a dash if there is neither."""
    if value != value:
        return "–"
    ends = f" [{low:{sign}.{digits}f}, {high:{sign}.{digits}f}]" if low == low else ""
    return f"{value:{sign}.{digits}f}{ends}"


# --- LaTeX ---------------------------------------------------------------------------------------------------------


def as_latex(comparison: Comparison) -> str:
    """The text of `write_latex`."""
    table = flat(comparison)
    cells = pd.DataFrame({title: [_as_math(make(row)) for row in table.to_dict("records")] for title, make in _LATEX})
    cells.insert(0, "Condition", table["condition"].to_numpy())
    style = cells.style.hide(axis="index").format(escape="latex", subset=["Condition"])
    return _head(comparison) + style.to_latex(hrules=True, column_format="l" + "r" * len(_LATEX))


def _head(comparison: Comparison) -> str:
    r"""Comments on top: what ``\input`` needs, and what the columns are."""
    level, family = f"{CONFIDENCE * 100:g} %", int(comparison.pairs["p"].notna().sum())
    lines = (
        r"Statistics of a wobblesim study; needs \usepackage{booktabs}.",
        f"Mean, median, difference: performance in body lengths; {level} intervals (Student; exact; Student).",
        f"Difference: from {comparison.baseline}, paired by seed. p: Wilcoxon's signed-rank test, two-sided.",
        f"Holm: the same, corrected for {family} test{'' if family == 1 else 's'}; * below {comparison.alpha:g}.",
        f"Effect: matched-pairs rank-biserial correlation with {level} interval (Wilson).",
    )
    return "".join(f"% {line}\n" for line in lines)


def _holm_with_star(row: Mapping[str, Any]) -> str:
    return p_text(row["p_holm"]) + ("*" if row["significant"] is True else "")


_LATEX: list[tuple[str, Callable[[Mapping[str, Any]], str]]] = [
    ("Runs", lambda row: f"{row['runs']}"),
    ("Excluded", lambda row: f"{row['excluded']}"),
    ("Mean", lambda row: with_width(row["mean"], row["half_width"])),
    ("Median", lambda row: with_interval(row["median"], row["median_low"], row["median_high"])),
    ("Pairs", lambda row: "–" if pd.isna(row["n_pairs"]) else f"{row['n_pairs']}"),
    ("Difference", lambda row: with_width(row["difference"], row["difference_half_width"], sign="+")),
    ("$p$", lambda row: p_text(row["p"])),
    (r"$p_\mathrm{Holm}$", _holm_with_star),
    ("Effect", lambda row: with_interval(row["effect"], row["effect_low"], row["effect_high"], 2, "+")),
]
"""Columns of the LaTeX table after the first: title, and the cell of a row of the flat table."""


def _as_math(text: str) -> str:
    """A cell in LaTeX's mathematics, so that a minus is one."""
    if text == "–":
        return "--"
    for sign, command in (("±", r"\pm"), (" [", r"\;["), ("\N{NO-BREAK SPACE}", " "), ("*", "^{*}")):
        text = text.replace(sign, command)
    return f"${text}$"
