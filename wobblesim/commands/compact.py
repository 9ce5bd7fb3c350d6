"""`wobblesim compact`: one file for each condition and table."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wobblesim.commands.options import echo_json, json_option, plural, print_table, table
from wobblesim.commands.reading import reading

if TYPE_CHECKING:
    from wobblesim.study.compact import Compacted

NOT_SOUND, STOPPED = 3, 4


@click.command("compact")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@json_option
@click.pass_context
def command(ctx: click.Context, folder: Path, as_json: bool) -> None:
    """Merge the files of each condition in DIR into one for each table, with the same rows.

    Many small files are slow to open and to copy. Every file is held against its checksum before, and the new ones are
    read back and compared bit for bit before the old ones go. A condition with a damaged file stays as it is: exit code
    3. Seeds that are added later are in files beside; compacting again merges all. Nobody else may be writing.
    """
    from wobblesim.commands.stopping import stop_on_signals
    from wobblesim.study.compact import compact

    def promise() -> None:
        click.echo("stopping; the condition in work stays as it was", err=True)

    with reading(f"compacting {folder}") as tell, stop_on_signals(promise, lambda: None) as stop:
        done = compact(folder, tell, stop)
    for note in done.notes:
        click.echo(note, err=True)
    _report(done, as_json)
    if done.stopped:
        click.echo(f"stopped; to go on: wobblesim compact {shlex.quote(str(folder))}", err=True)
        ctx.exit(STOPPED)
    if any(condition.findings for condition in done.conditions):
        ctx.exit(NOT_SOUND)


def _report(done: Compacted, as_json: bool) -> None:
    """Print files and bytes before and after, and what was left as it was."""
    total = {
        name: [sum(getattr(condition, name)[when] for condition in done.conditions) for when in (0, 1)]
        for name in ("files", "bytes")
    }
    if as_json:
        conditions = [_as_data(condition) for condition in done.conditions]
        echo_json({"results": str(done.folder), **total, "conditions": conditions, "stopped": done.stopped})
        return
    rows = [
        [
            it.condition,
            f"{it.runs:,}",
            *(f"{count:,}" for count in it.files),
            *(f"{size / 1e6:,.2f}" for size in it.bytes),
        ]
        for it in done.conditions
    ]
    print_table(table(["condition", "runs", "files before", "after", "MB before", "after"], rows))
    for condition in done.conditions:
        for path, what, remedy in condition.findings:
            click.echo(f"{path}: {what}; {remedy}")
    before, after = total["files"]
    click.echo(
        f"{plural(before, 'file')}, {total['bytes'][0] / 1e6:,.1f} MB before; "
        f"{plural(after, 'file')}, {total['bytes'][1] / 1e6:,.1f} MB after"
    )


def _as_data(condition: Any) -> dict[str, Any]:
    findings = [finding._asdict() for finding in condition.findings]
    sizes = {"files": condition.files, "bytes": condition.bytes}
    return {"condition": condition.condition, "runs": condition.runs, **sizes, "findings": findings}
