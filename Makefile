# Everything here sets up .venv by itself from Python >= 3.11 with pip; nothing is installed elsewhere.
#   make demo     the main job on robot meshes, a picture, the paper, an arm in a shelf
#   make test     the quick suite          make check    lint, types, import rules
#   make verify   the long proofs          make bench    the benchmarks
#   make fuzz     bad input by the thousand, interrupts, damaged files
#   make bounds   the quick suite with the bounds of every array in the kernels checked; for the night
#   make docs     the documentation, as pages in docs/_build/html
# PYTHON=python3.13 chooses the interpreter that .venv is made with.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet
PYTEST_OPTIONS ?=
PYTEST := $(BIN)/python -m pytest $(PYTEST_OPTIONS)
THREADS ?= 2

.PHONY: help demo test verify fuzz bounds bench check docs clean
help:
	@sed -n 's/^# \{0,1\}//p' Makefile | head -n 8

# What compiling does not need is installed beside it.
demo: $(VENV)/.core
	@$(BIN)/python -m loewner compile --only verdicts robots fits paper & compiling=$$!; \
	  $(MAKE) --no-print-directory $(VENV)/.demo; installed=$$?; wait $$compiling && exit $$installed
	$(BIN)/python examples/demo.py

test: $(VENV)/.dev
	$(BIN)/python -m loewner compile
	$(PYTEST) -n $(THREADS) --dist loadfile -m "not verify and not fuzz" tests

verify: $(VENV)/.dev
	$(PYTEST) -s -m verify tests

fuzz: $(VENV)/.dev
	$(BIN)/python -m loewner compile
	$(PYTEST) -s -n $(THREADS) -m fuzz tests/fuzz

# Compiled code of its own: Numba puts a check before every access to an array.
bounds: $(VENV)/.dev
	NUMBA_BOUNDSCHECK=1 $(BIN)/python -m loewner compile
	NUMBA_BOUNDSCHECK=1 $(PYTEST) -n $(THREADS) --dist loadfile -m "not verify and not fuzz" tests

bench: $(VENV)/.bench
	$(BIN)/python benchmarks/fits.py
	$(BIN)/python benchmarks/run.py

check: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m loewner compile
	$(PYTEST) -q src

# Every warning is an error, a link that leads nowhere among them. Nothing is downloaded.
docs: $(VENV)/.docs
	$(BIN)/python -m sphinx -W --keep-going -n -q -b html docs docs/_build/html

clean:
	rm -rf $(VENV) docs/_build docs/measured.md docs/reference/command.md docs/reference/generated .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis .benchmarks demo-out

# A stamp file says that what it depends on was installed; a half-done installation leaves none.
$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "loewner needs Python >= 3.11; try make PYTHON=python3.13 ..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.core: requirements/core.txt pyproject.toml | $(BIN)/python
	$(PIP) -r requirements/core.txt
	$(PIP) --no-deps --editable .
	@touch $@

$(VENV)/.demo: requirements/demo.txt requirements/data.txt $(VENV)/.core
	$(PIP) -r requirements/demo.txt
	$(PIP) --no-deps -r requirements/data.txt
	@touch $@

$(VENV)/.dev: requirements/dev.txt $(VENV)/.demo
	$(PIP) -r requirements/dev.txt
	@touch $@

$(VENV)/.bench: requirements/bench.txt $(VENV)/.dev
	$(PIP) --no-deps -r requirements/bench.txt
	@touch $@

$(VENV)/.docs: requirements/docs.txt $(VENV)/.demo
	$(PIP) -r requirements/docs.txt
	@touch $@
