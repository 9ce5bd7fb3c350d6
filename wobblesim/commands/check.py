"""`wobblesim check`: is this configuration sound, and what does it ask for?"""

from __future__ import annotations

import click

from wobblesim.commands.options import config_options, echo_json, json_option, plural


@click.command("check")
@config_options
@json_option
def command(config: str, settings: tuple[str, ...], seeds: str | None, as_json: bool) -> None:
    """Check a configuration: every key, every condition, every robot.

    Prints what it asks for, or for each fault the file, line, column and key, what is wrong and what is allowed (exit
    code 2).
    """
    from wobblesim.config import load_config, remarks

    loaded = load_config(config, settings, seeds)
    from wobblesim.study.plan import lane_steps, study  # a bad file is answered before the simulator is imported

    laid_out = study(loaded)
    work = len(laid_out.seeds) * sum(map(lane_steps, laid_out.setups.values()))
    if as_json:
        asked = {"name": loaded.name, "conditions": list(laid_out.conditions), "seeds": len(laid_out.seeds)}
        echo_json(asked | {"runs": laid_out.n_runs, "lane_steps": work, "remarks": list(remarks(loaded))})
        return
    for remark in remarks(loaded):
        click.echo(f"note: {remark}", err=True)
    click.echo(
        f"{config}: sound; {plural(len(laid_out.conditions), 'condition')}, {plural(len(laid_out.seeds), 'seed')}, "
        f"{plural(laid_out.n_runs, 'run')}, at most {work:.3g} lane-steps"
    )
