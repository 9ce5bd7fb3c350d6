"""`wobblesim verify`: is everything in a results folder what was written?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wobblesim.commands.options import echo_json, json_option, plural
from wobblesim.commands.reading import reading

if TYPE_CHECKING:
    from wobblesim.study.verify import Verified

NOT_SOUND = 3


@click.command("verify")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--repair", is_flag=True, help="Put aside what is not sound, so that `sweep` computes its runs anew.")
@json_option
@click.pass_context
def command(ctx: click.Context, folder: Path, repair: bool, as_json: bool) -> None:
    """Read every byte in DIR and name what is altered, missing, doubled or foreign.

    It only reads, so it works while a sweep runs. With --repair, for which nobody else may be writing, what is not
    sound goes into DIR/quarantine, and the manifest names what is left: all of it can be used at once, and the sweep
    command, given again, computes the lost runs anew. Exit code 3 if anything was found.
    """
    from wobblesim.study.repair import repair as mend
    from wobblesim.study.verify import verify

    with reading(f"verifying {folder}") as tell:
        mended = mend(folder, tell) if repair else None
        verified = mended.before if mended else verify(folder, tell)
    if as_json:
        data = _as_data(verified)
        if mended:
            data["repaired"] = {
                "done": mended.done,
                "missing": mended.missing,
                "left": _as_data(mended.after)["findings"],
            }
        echo_json(data)
    else:
        for line in _as_text(verified):
            click.echo(line)
        for line in (
            (*mended.done, f"{plural(mended.missing, 'run')} missing: give the sweep command again") if mended else ()
        ):
            click.echo(line)
    if verified.findings:
        ctx.exit(NOT_SOUND)


def _as_data(verified: Verified) -> dict[str, Any]:
    counts = {name: getattr(verified, name) for name in ("runs", "files", "rows", "bytes", "seconds")}
    findings = [finding._asdict() for finding in verified.findings]
    who = {"pending": verified.pending, "writers": verified.writers}
    return {"results": str(verified.folder), "sound": not findings, **counts, "findings": findings, **who}


def _as_text(verified: Verified) -> list[str]:
    lines = [f"{path}: {what}; {remedy}" for path, what, remedy in verified.findings]
    if verified.pending:
        by = ", ".join(verified.writers)
        lines.append(f"{plural(len(verified.pending), 'file')} not judged: {by} is about to say what they are")
    speed = verified.bytes / max(verified.seconds, 1e-9) / 1e6
    held = (plural(getattr(verified, name), name[:-1]) for name in ("runs", "files", "rows"))
    lines.append(
        f"sound: {', '.join(held)}, {verified.bytes / 1e6:,.1f} MB; "
        f"{plural(len(verified.findings), 'finding')} ({verified.seconds:.1f} s, {speed:,.0f} MB/s)"
    )
    return lines
