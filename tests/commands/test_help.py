"""Help is quick and complete, and needs nothing that computes."""

import subprocess
import sys
import time
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from wobblesim.commands import COMMANDS, main

ROOT = Path(__file__).parents[2]
HEAVY = ("numba", "pandas", "pyarrow", "matplotlib", "scipy", "numpy", "rich", "pydantic")


@pytest.mark.parametrize("arguments", [["--help"], ["sweep", "--help"], ["status", "-h"]])
def test_help_imports_nothing_heavy(arguments):
    script = (
        "import sys; from wobblesim.commands import main\n"
        f"try: main({arguments!r})\n"
        f"finally: print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    found = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert found.stdout.startswith("Usage:")
    assert found.stderr.strip() == "[]"


def test_help_is_quick():
    times = []
    for _ in range(5):
        begun = time.perf_counter()
        subprocess.run([sys.executable, "cli.py", "--help"], cwd=ROOT, capture_output=True, check=True)
        times.append(time.perf_counter() - begun)
    assert min(times) < 0.3  # measured 0.07 s


def commands() -> list[click.Command]:
    context = click.Context(main)
    return [command for name in COMMANDS if (command := main.get_command(context, name))]


def test_each_command_has_its_name_and_a_sentence_in_the_list():
    listed = CliRunner().invoke(main, ["--help"]).stdout
    for name, command in zip(COMMANDS, commands(), strict=True):
        assert command.name == name
        assert command.get_short_help_str()
        assert f"\n  {name} " in listed


@pytest.mark.parametrize("command", commands(), ids=lambda command: command.name)
def test_each_option_of_a_command_has_help(command):
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help, parameter.name


@pytest.mark.parametrize("name", ["--help", "-h"])
def test_help_has_no_escape_codes_and_goes_to_stdout(name):
    found = CliRunner().invoke(main, [name])
    assert (found.exit_code, found.stderr) == (0, "")
    assert "\x1b" not in found.stdout


def test_the_version_is_told():
    found = CliRunner().invoke(main, ["--version"])
    assert found.exit_code == 0
    assert found.stdout.startswith("wobblesim ")


@pytest.mark.parametrize("arguments", [["sweeep"], ["sweep"], ["sweep", "a", "b"], ["sweep", "a", "--threads", "0"]])
def test_bad_usage_is_exit_code_2(arguments):
    found = CliRunner().invoke(main, arguments)
    assert found.exit_code == 2
    assert found.stderr.startswith("Usage:")
    assert found.stdout == ""
