"""A configuration is data: nothing that it holds is run, imported or opened."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from wobblesim.config import ConfigError, parse_config, reading

ROOT = Path(__file__).parents[2]
LOADERS = [yaml.SafeLoader, *([yaml.CSafeLoader] if yaml.__with_libyaml__ else [])]

# Each makes the file MARKER, or would import something, where a reader follows Python's tags.
TAGS = [
    '!!python/object/apply:os.system ["touch MARKER"]',
    '!!python/object/apply:subprocess.Popen [["touch", "MARKER"]]',
    '!!python/object/apply:subprocess.check_output {args: [["touch", "MARKER"]]}',
    "!!python/object/apply:builtins.exec [\"open('MARKER', 'w')\"]",
    "!!python/object/apply:builtins.eval [\"open('MARKER', 'w')\"]",
    '!!python/object/apply:builtins.open ["MARKER", "w"]',
    '!!python/object/apply:pathlib.Path.touch [!!python/object/apply:pathlib.Path ["MARKER"]]',
    '!!python/object/new:os.system ["touch MARKER"]',
    '!!python/object/new:subprocess.Popen [["touch", "MARKER"]]',
    "!!python/object/new:type {args: [x, !!python/tuple [], {}], listitems: MARKER}",
    "!!python/object:os.PathLike {}",
    "!!python/object/apply:shutil.copy [cli.py, MARKER]",
    "!!python/object/apply:os.mkdir [MARKER]",
    "!!python/object/apply:__builtin__.open [MARKER, w]",
    '!!python/object/apply:webbrowser.open ["file:MARKER"]',
    "!!python/name:os.system",
    "!!python/name:wobblesim.commands.main",
    "!!python/module:antigravity",
    "!!python/module:this",
    "!!python/tuple [1, 2]",
    "!<tag:yaml.org,2002:python/object/apply:os.system> [touch MARKER]",
    "!!python/bytes aGVsbG8=",
    "!!python/complex 1+2j",
]
HOMES = ["{}\n", "name: {}\n", "name: ab\nseeds: [0, {} ]\n", "name: ab\nconditions:\n  cd:\n    wobble: {}\n"]


@pytest.mark.parametrize("loader", LOADERS, ids=lambda loader: loader.__name__)
@pytest.mark.parametrize("tag", TAGS)
def test_se_1_python_tags_are_refused_and_nothing_is_run(
    tag: str, loader: type, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(reading, "LOADER", loader)
    before = set(sys.modules)
    for home in HOMES:
        with pytest.raises(ConfigError, match=r"the tag .* is not supported") as caught:
            parse_config(home.format(tag), source="study.yaml")
        assert str(caught.value).startswith(f"study.yaml:{home.count(chr(10))}:")
    with pytest.raises(ConfigError, match=r"the tag .* is not supported"):
        parse_config("name: ab\n", [f"physics.dt={tag}"])
    assert list(tmp_path.iterdir()) == []
    assert set(sys.modules) == before


def test_se_1_the_payloads_do_what_they_say_where_they_are_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    yaml.load(TAGS[5], Loader=yaml.UnsafeLoader).close()
    assert (tmp_path / "MARKER").exists()


PAYLOADS = [
    "os:system",
    "os.system",
    "antigravity",
    "wobblesim.commands:main",
    "__import__('os').system('touch MARKER')",
    "exec(open('MARKER', 'w'))",
    "lambda: open('MARKER', 'w')",
    "{{ ''.__class__.__mro__[1].__subclasses__() }}",
    "{0.__class__.__init__.__globals__}",
    "%(name)s %s %n",
    "${oc.env:HOME}",
    "$(touch MARKER)",
    "`touch MARKER`",
    "; touch MARKER",
    "!!python/name:os.system",
    "file:secret.yaml",
    "__class__",
    "__init__.__globals__",
    "model_fields",
    "model_config",
]
PLACES = [
    "name: {}",
    "{}: 1",
    "name: ab\nseeds: {}",
    "name: ab\nrobot: {{kind: {}}}",
    "name: ab\nrobot: {{kind: starfish, {}: 1}}",
    "name: ab\nphysics: {{integrator: {}}}",
    "name: ab\nphysics: {{precision: {}}}",
    "name: ab\nlearning: {{direction: {}}}",
    "name: ab\nwobble: {{dimension: {}, amplitude: 0.1, period: 9}}",
    "name: ab\nwobble: {{dimension: [mass, {}], amplitude: 0.1, period: 9}}",
    "name: ab\nlog: {}",
    "name: ab\nsweep: {{{}: [1]}}",
    "name: ab\nsweep: {{physics.{}: [1]}}",
    "name: ab\nsweep: {{physics.integrator: [{}]}}",
    "name: ab\nconditions: {{{}: {{}}}}",
    "name: ab\nconditions: {{cd: {{{}: null}}}}",
    "name: ab\nconditions: {{cd: {{log: {}}}}}",
]
WATCHED = """
import json, sys
sys.path.insert(0, sys.argv[1])
from wobblesim.config import ConfigError, expand, parse_config
texts = json.load(sys.stdin)
heard, accepted = [], []
def read(text):
    try:
        expand(parse_config(text))
        accepted.append(text)
    except ConfigError as error:
        error.report()
for text in ("name: ab", "name: 1", "nam: 1", "name: [", texts[0]):  # what is imported at the first use is imported now
    read(text)
known = set(sys.modules)
quiet = ("object.__getattr__", "sys._getframe", "code.__new__", "gc.", "cpython.", "builtins.id", "sys.excepthook")
sys.addaudithook(lambda event, args: event.startswith(quiet) or heard.append([event, repr(args)[:80]]))
for text in texts:
    read(text)
events = list(heard)
print(json.dumps([events, sorted(set(sys.modules) - known), accepted]))
"""


def test_se_2_no_text_of_a_configuration_is_run_imported_or_opened(tmp_path: Path) -> None:
    texts = [place.format(json.dumps(payload)) + "\n" for place in PLACES for payload in PAYLOADS]
    command = [sys.executable, "-c", WATCHED, str(ROOT)]
    done = subprocess.run(
        command, cwd=tmp_path, input=json.dumps(texts), capture_output=True, text=True, check=True, timeout=60
    )
    heard, imported, accepted = json.loads(done.stdout)
    assert heard == []  # no import, exec, compile, open, system or socket, of all that Python tells an auditor
    assert imported == []
    names = [payload for payload in PAYLOADS if f'name: "{payload}"\n' in accepted]
    assert names == ["os.system", "antigravity", "model_fields", "model_config"]  # names like any other
    assert list(tmp_path.iterdir()) == []


# --- the sources ----------------------------------------------------------------------------------------------------

IMPORT_BY_NAME = {
    "wobblesim/__init__.py": "names and modules of a table in that file",
    "wobblesim/analysis/figures/registry.py": "modules of a table in that file",
    "wobblesim/commands/__init__.py": "names and modules of a table in that file",
    "wobblesim/physics/kernels.py": "the name of the package itself",
    "wobblesim/study/provenance.py": "packages that the file names, for their versions",
}
ATTRIBUTE_BY_NAME = {
    "wobblesim/__init__.py": "names of a table in that file",
    "wobblesim/commands/__init__.py": "classes of errors that the file names",
    "wobblesim/commands/explain.py": "columns that the file names",
    "wobblesim/commands/sweep.py": "columns that the file names",
    "wobblesim/config/lookup.py": "the four bounds of a number",
}


def calls(path: Path) -> Iterator[tuple[str, ast.Call]]:
    """Yield the called name, without what stands before its last dot, of each call in a file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
            name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
            is_method = isinstance(node.func, ast.Attribute)
            yield f".{name}" if is_method else name, node


SOURCES = {path.relative_to(ROOT).as_posix(): path for path in sorted((ROOT / "wobblesim").rglob("*.py"))}


def test_se_2_no_source_evaluates_text_or_imports_by_a_name_that_it_does_not_hold() -> None:
    found = {(name, file) for file, path in SOURCES.items() for name, _ in calls(path)}
    assert len(found) > 1000
    forbidden = {"eval", "exec", "compile", "__import__", ".load_module", ".exec_module", ".spec_from_file_location"}
    assert {(name, file) for name, file in found if name in forbidden} == set()
    assert {file for name, file in found if name in (".import_module", "import_module")} == set(IMPORT_BY_NAME)
    assert {name for name, _ in found if name in (".unsafe_load", ".full_load", ".load_all", "unsafe_load")} == set()


def reads_configurations(path: Path) -> bool:
    """Whether a file imports something of `wobblesim.config`."""
    imports = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if type(node) is ast.ImportFrom]
    names = {f"{node.module}.{alias.name}" for node in imports for alias in node.names}
    return any(name.startswith("wobblesim.config") for name in names)


def test_se_2_no_attribute_is_looked_up_by_a_name_from_a_configuration() -> None:
    readers = {file for file, path in SOURCES.items() if "wobblesim/config/" in file or reads_configurations(path)}
    assert "wobblesim/study/plan.py" in readers
    by_name = {
        file
        for file in readers
        for name, call in calls(SOURCES[file])
        if name in ("getattr", "setattr", "delattr") and not isinstance(call.args[1], ast.Constant)
    }
    assert by_name <= set(ATTRIBUTE_BY_NAME)
