"""Sphinx configuration. Build with `make docs`."""

import sys
from importlib import metadata
from pathlib import Path
from typing import Annotated, get_args, get_origin

from pydantic import BaseModel

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent))

project = "wobblesim"
author = "wobblesim developers"
copyright = "2026, wobblesim developers"
release = metadata.version("wobblesim")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx_click",
]
exclude_patterns = ["_build", "_generated"]
myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # the notebook comes with what it gave; a test of the night runs it

autodoc_typehints = "none"  # the NumPy-style docstrings give types, shapes and units
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = "wobblesim"
html_static_path = ["_static"]
html_css_files = ["wide.css"]


def models_of(annotation):
    """Pydantic models that a key's type names, through unions, lists and annotations."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    parts = get_args(annotation)[:1] if get_origin(annotation) is Annotated else get_args(annotation)
    return [model for part in parts for model in models_of(part)]


def written(field):
    """A default as YAML says it; a section's default is given by its own keys."""
    if field.is_required():
        return "required"
    default = field.default
    if isinstance(default, BaseModel) or default == {}:
        return ""
    names = {None: "null", True: "true", False: "false"}
    if default is None or isinstance(default, bool):
        return f"`{names[default]}`"
    return f"`{list(default)}`" if isinstance(default, tuple) else f"`{default}`"


def rows_of(model, prefix=""):
    """Rows (key, default, meaning) of a section and of those inside it."""
    for name, field in model.model_fields.items():
        inner = models_of(field.annotation)
        yield f"| `{prefix}{name}` | {written(field)} | {field.description or ''} |"
        for section in inner:
            kind = section.model_fields.get("kind")
            if kind and len(inner) > 1:
                yield f"| **{prefix}{name}** | | *of kind {get_args(kind.annotation)[0]}:* |"
            dot = "[]." if "tuple" in str(field.annotation) else "."
            yield from rows_of(section, f"{prefix}{name}{dot}")


def write_keys(_app):
    """Make the table of YAML keys from the schema itself, so that the two cannot disagree."""
    from wobblesim.config import SweepConfig

    study_first = ["name", "seeds", "sweep", "conditions"]
    lines = ["| Key | Default | Meaning and range |", "|---|---|---|", *rows_of(SweepConfig)]
    ordered = sorted(lines[2:], key=lambda row: not any(row.startswith(f"| `{key}`") for key in study_first))
    folder = DOCS / "_generated"
    folder.mkdir(exist_ok=True)
    (folder / "keys.md").write_text("\n".join(lines[:2] + ordered) + "\n", encoding="utf-8")


def setup(app):
    app.connect("builder-inited", write_keys)
