# The one button of the project. Needs make and Python >= 3.11; everything is installed into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install -qq --disable-pip-version-check --no-input -c constraints.txt
# A stamp is older than these when the environment has to be brought up to date.
PINS := pyproject.toml constraints.txt

.DEFAULT_GOAL := help
.PHONY: help quickstart test test-nightly lint types docs bench clean

help:  ## this list
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/  make \1|\2/p' Makefile | awk -F'|' '{ printf "%-20s %s\n", $$1, $$2 }'

quickstart: $(VENV)/.runtime  ## install, run a small sweep, say where results and picture are
	$(BIN)/wobblesim sweep configs/quickstart.yaml

test: $(VENV)/.test  ## run the tests (pass options with ARGS="-m nightly")
	$(BIN)/python -m pytest $(ARGS)

test-nightly: $(VENV)/.test $(VENV)/.slurm  ## the long tests: faults, fuzz, worker kills, all scenes
	$(BIN)/python -m pytest -m nightly $(ARGS)

lint: $(VENV)/.lint  ## format check, ruff, layers
	$(BIN)/ruff format --quiet --check . || { echo "Run '$(BIN)/ruff format .' to format."; exit 1; }
	$(BIN)/ruff check --quiet .
	$(BIN)/lint-imports

types: $(VENV)/.lint  ## pyright
	$(BIN)/pyright

docs: $(VENV)/.docs  ## HTML pages in docs/_build/html
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build/html

bench: $(VENV)/.runtime  ## throughput of this machine
	$(BIN)/wobblesim bench

clean:  ## remove the environment and all caches; results stay
	rm -rf $(VENV) docs/_build build dist .pytest_cache .ruff_cache .mypy_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "wobblesim needs Python 3.11 or newer, and '$(PYTHON)' is not: try 'make PYTHON=python3.12 ...'." >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.runtime: $(BIN)/python $(PINS)
	@echo "Installing into $(VENV) (once) ..."
	@$(PIP) -e .
	@touch $@

$(VENV)/.test $(VENV)/.lint $(VENV)/.docs $(VENV)/.slurm: $(VENV)/.%: $(BIN)/python $(PINS)
	@echo "Installing into $(VENV) (once) ..."
	@$(PIP) -e '.[$*]'
	@touch $@
