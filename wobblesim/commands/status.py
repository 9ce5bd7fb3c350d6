"""`wobblesim status`: how far is the sweep in this folder?"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wobblesim.commands.options import echo_json, json_option, print_table, table

if TYPE_CHECKING:
    from wobblesim.study.manifest import Manifest


@click.command("status")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@json_option
def command(folder: Path, as_json: bool) -> None:
    """Say how far the sweep in DIR is; it only reads files, so it works from another shell while the sweep runs."""
    from wobblesim.study.errors import StoreError
    from wobblesim.study.lock import writers
    from wobblesim.study.manifest import manifests, read_manifest

    if not manifests(folder):
        raise StoreError(f"{folder} holds no results; give the folder that a sweep writes")
    manifest = read_manifest(folder)
    rows = _rows(folder, manifest)
    errors = sorted(
        {f"{condition}: {error.strip().splitlines()[-1]}" for (condition, _), error in manifest.failures.items()}
    )
    found = writers(folder)
    if as_json:
        echo_json({"results": str(folder), "writers": found, "conditions": rows, "errors": errors})
        return
    columns = ["wanted", "done", "failed", "missing", "diverged", "refined"]
    cells = [[row["condition"], *(f"{row[name]:,}" for name in columns), row["in_progress"]] for row in rows]
    titles = ["runs", "done", "failed", "missing", "trials diverged", "refined", "last checkpoint"]
    print_table(table(["condition", *titles], cells))
    for line in (*manifest.unreadable, *errors):
        click.echo(line, err=True)
    click.echo(f"being written by {', '.join(found)}" if found else "nobody is writing")


def _rows(folder: Path, manifest: Manifest) -> list[dict[str, Any]]:
    """One row a condition; `failed` counts runs without a score and runs whose learner raised."""
    wanted = manifest.wanted()
    done = Counter(condition for condition, _ in manifest.runs)
    failed = Counter(condition for (condition, _), run in manifest.runs.items() if run.status == "failed")
    failed += Counter(condition for condition, _ in manifest.failures)
    diverged, refined = Counter[str](), Counter[str]()
    for (condition, _), run in manifest.runs.items():
        diverged[condition] += run.diverged
        refined[condition] += run.refined
    return [
        {
            "condition": condition,
            "wanted": len(wanted[condition]),
            "done": done[condition],
            "failed": failed[condition],
            "missing": len(wanted[condition]) - done[condition],
            "diverged": diverged[condition],
            "refined": refined[condition],
            "in_progress": _in_progress(folder, condition),
        }
        for condition in manifest.conditions
    ]


def _in_progress(folder: Path, condition: str) -> str:
    """The checkpoints of a condition, in words."""
    from wobblesim.study.resume import standing

    return "; ".join(f"{head.group}: epoch {head.epoch}" for head in standing(folder, condition))
