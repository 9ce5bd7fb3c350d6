"""`wobblesim schema`: what a configuration may hold, for editors."""

from __future__ import annotations

import click


@click.command("schema")
def command() -> None:
    """Print the JSON Schema of a configuration, by which an editor completes keys and marks mistakes.

    \b
    Write it beside your studies:
        wobblesim schema > schema.json
    and begin each of them with the line
        # yaml-language-server: $schema=schema.json
    or with the path of the schema from there. Editors with the YAML language
    server read that line, such as VS Code with the YAML extension by Red Hat,
    Neovim, Emacs and Helix.

    The schema knows every key with its meaning, unit and range. Rules between keys, such as fewer parents than
    behaviours, are checked by `wobblesim check`.
    """  # noqa: D301 - click reads the backspace
    import json

    from wobblesim.config import json_schema

    click.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))
