import re
import subprocess
import tomllib
from importlib import metadata
from pathlib import Path

import click
import pytest

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LISTING = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
TEXT_SUFFIXES = {"", ".cff", ".cfg", ".html", ".md", ".py", ".toml", ".txt", ".yaml", ".yml"}
IGNORED_FOLDERS = {".git", ".venv", ".hypothesis", "__pycache__", "_build", "build", "dist", "results"}

# Options and places that belong to one machine; written so that this file does not find itself.
PLACES = re.compile(r"index[-]url|find[-]links|file:[/]{2}|/roo[t]/|/hom[e]/\w|/User[s]/\w")


def project_files():
    """Text files that git tracks or would; without git, those in the tree that no tool made."""
    try:
        listing = subprocess.run(LISTING, cwd=ROOT, capture_output=True, check=True, text=True).stdout
        paths = [ROOT / name for name in listing.split("\0") if name]
    except (OSError, subprocess.CalledProcessError):
        paths = [path for path in ROOT.rglob("*") if not IGNORED_FOLDERS & set(path.relative_to(ROOT).parts)]
    return [path for path in paths if path.suffix in TEXT_SUFFIXES and path.is_file()]


def normalised(name):
    return re.sub(r"[-_.]+", "-", name).lower()


def pins():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    return dict(line.split("==") for line in lines if line and not line.startswith("#"))


def requirements():
    optional = PROJECT["optional-dependencies"]
    everything = PROJECT["dependencies"] + [name for extra in ("test", "lint", "docs") for name in optional[extra]]
    return [re.match(r"[\w.-]+", requirement).group() for requirement in everything]


def test_no_file_names_a_package_host_or_somebodys_machine():
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in project_files()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if PLACES.search(line)
    ]
    assert not found


def test_constraints_are_plain_pins():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    odd = [line for line in lines if line and not re.fullmatch(r"#.*|[\w.-]+==[\w.]+", line)]
    assert not odd


def test_every_requirement_is_pinned():
    pinned = {normalised(name) for name in pins()}
    assert {normalised(name) for name in requirements()} <= pinned


def test_installed_packages_are_the_pinned_major_versions():
    installed = {normalised(dist.metadata["Name"]): dist.version for dist in metadata.distributions()}
    wrong = {
        name: (pinned, installed[normalised(name)])
        for name, pinned in pins().items()
        if normalised(name) in installed and installed[normalised(name)].split(".")[0] != pinned.split(".")[0]
    }
    assert not wrong


def test_no_requirement_has_an_upper_bound():
    optional = [requirement for extra in PROJECT["optional-dependencies"].values() for requirement in extra]
    assert not [requirement for requirement in PROJECT["dependencies"] + optional if "<" in requirement]


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md"])
def test_make_commands_in_the_pages_exist(page):
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE))
    named = set(re.findall(r"\bmake ([a-z]+)\b", "\n".join(code_of(ROOT / page))))
    assert named
    assert named <= targets


def test_commands_in_the_readme_are_those_of_the_command_line():
    from wobblesim.commands import main

    named = set(re.findall(r"(?<!import )\bwobblesim ([a-z]+)\b", "\n".join(code_of(ROOT / "README.md"))))
    assert named == set(main.list_commands(click.Context(main)))


def code_of(page):
    """The code of a Markdown page: its fenced blocks and its `inline` pieces."""
    text = page.read_text(encoding="utf-8")
    fenced = re.findall(r"^```.*?^```", text, flags=re.MULTILINE | re.DOTALL)
    return fenced + re.findall(r"(?<!`)`([^`\n]+)`(?!`)", text)


def test_links_between_the_pages_lead_somewhere():
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    broken = [
        f"{page.relative_to(ROOT)}: {target}"
        for page in pages
        if "_build" not in page.parts
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
        if "://" not in target and not (page.parent / target).exists()
    ]
    assert not broken


def test_the_version_has_an_entry_in_the_changelog():
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## [{PROJECT['version']}]" in changelog


def test_the_formats_page_names_every_column():
    from wobblesim.study.schema import COLUMNS, PARAMETERS

    page = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    columns = {name for table in COLUMNS.values() for name in table if name not in PARAMETERS}
    assert not {name for name in columns if f"`{name}`" not in page}
