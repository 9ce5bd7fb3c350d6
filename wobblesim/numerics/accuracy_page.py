"""The page of the documentation that `wobblesim accuracy --page` writes: all its numbers come from the report."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence

from wobblesim.numerics import accuracy_tables as tables
from wobblesim.numerics.accuracy import PERFORMING, Row
from wobblesim.numerics.accuracy_report import Report
from wobblesim.numerics.accuracy_verdict import (
    BOUNDS,
    JUDGED,
    cheapest,
    goal,
    named,
    percent,
    sentence,
    whole,
)
from wobblesim.numerics.reference import LOOSER, TOLERANCE
from wobblesim.numerics.scenes import MORPHOLOGIES, SCENES

WIDTH = 120

HEAD = """\
<!-- Written by `wobblesim accuracy --page docs/accuracy.md`; change wobblesim/numerics/accuracy_page.py instead. -->

# Error against run time

What does a result cost, and by how much is it wrong? `wobblesim accuracy` measures both for every integrator, step,
precision, number of iterations and theta, on scenes from a spring with a closed form to the gait itself.

{form}{sentence}

![Work-precision diagrams: error against run time, a panel for each scene](_static/accuracy.png)

*Lower left is better. The grey band is the front: no cheaper setting is as exact. Dotted: how far the reference
itself may be off. [As SVG](_static/accuracy.svg); [all rows as CSV](_static/accuracy.csv).*

Measured with {conditions}.
"""

PROTOCOL = """\
## How it is measured

**Scenes.**

{scenes}

Behaviours are `default_rng(1)`; the gait is tried on {morphologies}.

**References.** Without a floor: the closed form of the oscillator, and SciPy's DOP853 (rtol and atol {tolerance:g})
on the equations written once more with NumPy. Their own error is what a tolerance {looser:g} times larger changes.
With a floor: an integrator of the same contact law at the smallest step, in float64; its own error is what twice that
step changes. An error smaller than its reference's own says nothing.

**Two laws.** `impulse` has a rigid contact law of its own, so it is compared with its own limit of small steps and
not with that of the compliant law. How far the two limits are apart is [below](#the-two-contact-laws).

**Run time.** One thread, full blocks of lanes, kernels compiled first. A run of a single step is taken off each run,
so that what a call costs before its first step does not count. All settings are timed once, then all again; the
shortest counts.

**Failures.** Trials are not repeated with a smaller step here. A setting of which one trial diverges has no error and
no run time, only a count.

## What the errors mean

- **node**: root mean square of the distance of the free nodes from where the reference has them at the end, u.
- **path**: the same over all recorded frames.
- **energy**: error of the energy of motion, springs and weight just before the end, as a fraction of the most that
  motion and springs hold in the reference. Not defined with a floor, which holds energy too.
- **median, 95 %, mean**: of the absolute error of the displacement over all trials, body lengths. **bias**: its mean
  with sign.
- **µs/s**: run time of a simulated second of one lane. **lost**: trials that diverged.
- **rank**: Spearman's correlation of the displacements with the reference's, mean over the morphologies. That is what
  a search goes by.

Node, path and energy errors are medians over the trials. In the tables \\* marks the front (no cheaper setting is as
exact, by the path or by the median) and = the shipped default.
"""

JUDGEMENT = """\
## What settings are judged by

By the median error of the gait's displacement after {short:g} s, in body lengths. {late}A mean over the trials would
be that of the few in which amplification has begun already; it and the 95th percentile stand beside the median. The
displacements after {short:g} s have a standard deviation of {spread} body lengths.
"""


def page(report: Report) -> str:
    """The whole page, Markdown."""
    parts = [_head(report), _default(report.rows), goal_section(report.rows), _judgement(report), _protocol()]
    parts += [_scene(report, scene) for scene in report.scenes]
    parts += [_laws(report), _sensitivity(report), AGAIN]
    return _wrapped("\n".join(part for part in parts if part))


def _wrapped(text: str) -> str:
    """The text with its long lines broken, but for tables and pictures."""
    return "\n".join(
        line if len(line) <= WIDTH or line.startswith(("|", "!", "<")) else _broken(line) for line in text.split("\n")
    )


def _broken(line: str) -> str:
    indent = "  " if line.startswith("- ") else ""
    kept = line.replace(" %", "\N{NO-BREAK SPACE}%")
    broken = textwrap.fill(kept, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
    return broken.replace("\N{NO-BREAK SPACE}", " ")


AGAIN = """\
## Measure it again

```shell
wobblesim accuracy --page docs/accuracy.md   # this page, some minutes
wobblesim accuracy --out results/accuracy    # tables on the terminal, Parquet and pictures
wobblesim accuracy --short                   # does it work? under a minute
```

In Python `wobblesim.numerics.accuracy.accuracy()` returns the rows as a pandas DataFrame.
"""


def _head(report: Report) -> str:
    form = "**The short form: a test of the program, nothing to judge by.** " if report.short else ""
    words = ", ".join(f"{name} {value}" for name, value in report.conditions.items())
    return HEAD.format(form=form, sentence=sentence(report.rows), conditions=words)


def _protocol() -> str:
    scenes = "\n".join(f"- `{name}`: {(make.__doc__ or '').strip()}" for name, make in SCENES.items())
    words = ", ".join(MORPHOLOGIES)
    return PROTOCOL.format(scenes=scenes, morphologies=words, tolerance=TOLERANCE, looser=LOOSER)


def _default(rows: Sequence[Row]) -> str:
    """Why the shipped default is what it is: its row, and those beside it."""
    judged = [r for r in whole(rows, JUDGED) if math.isfinite(r.error + r.seconds)]
    shipped = next((r for r in judged if r.shipped), None)
    if shipped is None:
        return ""
    lines = [
        "## Why the default is what it is",
        "",
        f"The shipped default is {_described(shipped)}. {_rival(rows, shipped)}",
        "",
    ]
    lines += [f"- {line}" for line in _beside(judged, shipped, rows)]
    return "\n".join([*lines, ""])


def _described(row: Row) -> str:
    return (
        f"**{named(row)} at dt {row.dt:.3g} s**: a median error of {percent(row.error)} of a body length after "
        f"{row.duration:g} s (95th percentile {percent(row.performance_p95)}), {row.seconds * 1e6:.3g} µs a simulated "
        "second of one lane"
    )


def _rival(rows: Sequence[Row], shipped: Row) -> str:
    best = cheapest(rows, BOUNDS[0])
    if best is shipped:
        return f"It is the cheapest setting below {percent(BOUNDS[0])}."
    if best is None:
        return f"No setting is below {percent(BOUNDS[0])}."
    share = 1.0 - best.seconds / shipped.seconds
    return (
        f"The cheapest below {percent(BOUNDS[0])} in this measurement is {named(best)} at dt {best.dt:.3g} s "
        f"({percent(best.error)}), which takes {100 * share:.0f} % less time. Its 95th percentile is "
        f"{percent(best.performance_p95)} against {percent(shipped.performance_p95)}, its mean error "
        f"{percent(best.performance_mean)} against {percent(shipped.performance_mean)}, and it ranks the behaviours "
        f"with a correlation of {best.rank:.3f} against {shipped.rank:.3f}."
    )


def _beside(judged: Sequence[Row], shipped: Row, rows: Sequence[Row]) -> Iterator[str]:
    """What a longer and a shorter step, the other precision and other thetas would change."""
    alike = [
        r
        for r in judged
        if (r.integrator, r.precision, r.theta) == (shipped.integrator, shipped.precision, shipped.theta)
    ]
    longer = min((r for r in alike if r.dt > shipped.dt), key=lambda r: r.dt, default=None)
    shorter = max((r for r in alike if r.dt < shipped.dt), key=lambda r: r.dt, default=None)
    for row, word in ((longer, "A longer step"), (shorter, "A shorter step")):
        if row:
            yield f"{word} of {row.dt:.3g} s: error {percent(row.error)}, {_times(row, shipped)} the time."
    for row in judged:
        if row.integrator != shipped.integrator or row.dt != shipped.dt or row.width:
            continue
        if row.theta == shipped.theta and row.precision != shipped.precision:
            yield f"{row.precision}: error {percent(row.error)}, {_times(row, shipped)} the time."
        if row.theta != shipped.theta:
            yield f"Theta {row.theta:g}: error {percent(row.error)}{_lost(rows, row)}."
    late = next((r for r in whole(rows, "long-gait") if r.shipped), None)
    if late:
        yield (
            f"After {late.duration:g} s: median error {percent(late.error)}, rank correlation {late.rank:.3f}, bias "
            f"{percent(late.performance_bias)} ± {percent(late.performance_bias_error)}, {late.failures} of "
            f"{late.trials} trials diverged."
        )


def _times(row: Row, shipped: Row) -> str:
    return f"{row.seconds / shipped.seconds:.2g} times"


def _lost(rows: Sequence[Row], row: Row) -> str:
    """How many whole trials a theta loses, at which step."""
    alike = [
        r for r in whole(rows, "long-gait")
        if (r.integrator, r.theta, r.precision) == (row.integrator, row.theta, row.precision) and r.failures
    ]  # fmt: skip
    words = ", ".join(
        f"{r.failures} of {r.trials} trials of {r.duration:g} s diverge at dt {r.dt:.3g} s" for r in alike
    )
    return f"; {words}" if words else ""


def goal_line(rows: Sequence[Row]) -> str:
    """How far the project's goal is, in a sentence; empty if it was not measured."""
    found = goal(rows)
    if found is None:
        return ""
    ours, theirs = found.ours, found.theirs
    return (
        f"Goal: {named(ours)} at dt {ours.dt:.3g} s takes {found.ratio:.3g} times less time than {named(theirs)} at dt "
        f"{theirs.dt:g} s, with a median error of {percent(ours.error)} against {percent(theirs.error)} (95th "
        f"percentile {percent(ours.performance_p95)} against {percent(theirs.performance_p95)})."
    )


def goal_section(rows: Sequence[Row]) -> str:
    """The goal, as a section."""
    line = goal_line(rows)
    if not line:
        return ""
    return (
        "## Against the paper's engine\n\n"
        "The goal of the project is 100 times less time, at an equal error of the gait, than the paper's engine "
        f"needs on one robot at a time: `impulse` at its step and iterations, compiled for one lane. So far: "
        f"{line.removeprefix('Goal: ')}\n\n"
        f"{_other_goals(rows)}\n\n"
        "Each is compared with the limit of its own contact law. The program's `impulse` on one lane stands for the "
        "engine; the engine itself was not run.\n"
    )


def _other_goals(rows: Sequence[Row]) -> str:
    """What the goal comes to by other measures of the same trials."""
    measures = {"mean error": "performance_mean", "95th percentile": "performance_p95", "rank correlation": "rank"}
    found = {words: goal(rows, measure) for words, measure in measures.items()}
    parts = [f"{g.ratio:.3g} times by the {words} (dt {g.ours.dt:.3g} s)" for words, g in found.items() if g]
    return f"At an equality of other measures it is {', '.join(parts)}."


def _judgement(report: Report) -> str:
    judged, late = whole(report.rows, JUDGED), [r for r in whole(report.rows, "long-gait") if math.isfinite(r.error)]
    known = [r for r in judged if math.isfinite(r.spread)]
    if not known:
        return ""
    words = ""
    if late:
        exact = min(late, key=lambda r: r.error)
        words = (
            f"Not after {exact.duration:g} s, since the gait amplifies any difference: then the reference itself is "
            f"off by {percent(exact.reference_performance_error)} in the median, the most exact setting by "
            f"{percent(exact.error)} (mean {percent(exact.performance_mean)}), and a shorter step hardly helps. "
        )
    head, text = JUDGEMENT.split("\n\n")
    text = " ".join(text.split("\n")).format(short=known[0].duration, late=words, spread=tables.number(known[0].spread))
    other = [*markdown(*tables.cheapest_table(report.rows)), ""]
    return "\n".join(
        [
            head,
            "",
            text.strip(),
            "",
            "The cheapest settings, were another measure of the same trials taken:",
            "",
            *other,
        ]
    )


def _scene(report: Report, scene: str) -> str:
    columns, cells = tables.scene_table(report.rows, scene)
    first = whole(report.rows, scene)[0]
    about = f"{first.trials} trials of {first.duration:g} s" if scene in PERFORMING else f"{first.duration:g} s"
    lines = [f"## Scene `{scene}`", "", f"{about}; {tables.reference_line(report.rows, scene)}.", ""]
    lines += [*markdown(columns, cells), ""]
    lines += [f"- {note}" for note in tables.notes(report.rows, scene)]
    return "\n".join(lines).rstrip() + "\n"


def _laws(report: Report) -> str:
    if not report.agreements:
        return ""
    lead = (
        "References of the rigid law against those of the compliant one, displacements in body lengths. Trial by "
        "trial the laws soon part, for a rebound is another thing in each; a ranking or a mean over many trials they "
        "share as far as the rank and the mean difference say."
    )
    return _tabled("The two contact laws", lead, tables.agreement_table(report.agreements))


def _sensitivity(report: Report) -> str:
    if not report.sensitivities:
        return ""
    lead = (
        "How far the end of the adult's gait moves at the shipped step when next to nothing is changed, body lengths. "
        "No comparison of single trials can be sharper than that."
    )
    return _tabled("How sensitive a gait is", lead, tables.sensitivity_table(report.sensitivities))


def _tabled(title: str, lead: str, table: tuple[Sequence[str], Sequence[Sequence[str]]]) -> str:
    """A section of a paragraph and a table."""
    return "\n".join([f"## {title}", "", lead, "", *markdown(*table), ""])


def markdown(columns: Sequence[str], cells: Sequence[Sequence[str]]) -> Iterator[str]:
    """Lines of a Markdown table whose first column is words."""
    yield f"| {' | '.join(columns)} |"
    yield "|---|" + "---:|" * (len(columns) - 1)
    for row in cells:
        yield "| " + " | ".join(cell.replace("*", r"\*") for cell in row) + " |"
