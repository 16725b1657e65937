# Everything here sets up .venv by itself from Python >= 3.11 with pip; nothing is installed elsewhere.
#   make demo     the main job on robot meshes, a picture, the paper, an arm in a shelf
#   make test     the quick suite          make check    lint, types, import rules
#   make verify   the long proofs          make bench    the benchmarks
#   make fuzz     bad input by the thousand, interrupts, damaged files
#   make bounds   the quick suite with the bounds of every array in the kernels checked; for the night
#   make docs     the documentation, as pages in docs/_build/html
#   make wheel    a wheel with the native library, in dist/        make sdist    the sources, in dist/
#   make test-wheel    the quick suite against that wheel, installed
# PYTHON=python3.13 chooses the interpreter that .venv is made with.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet
PYTEST_OPTIONS ?=
PYTEST := $(BIN)/python -m pytest $(PYTEST_OPTIONS)
THREADS ?= 2

# The native library, for this machine's processor. Without a C compiler, what Numba compiles on first use is compiled
# now; beside a library that does nothing.
BUILD := $(BIN)/python native/build.py || true
COMPILE := $(BIN)/python -m loewner compile

.PHONY: help demo test verify fuzz bounds bench check docs wheel sdist test-wheel clean
help:
	@sed -n 's/^# \{0,1\}//p' Makefile | head -n 10

# What compiling does not need is installed beside it.
demo: $(VENV)/.compiler
	@{ $(BUILD); } & building=$$!; \
	  $(MAKE) --no-print-directory $(VENV)/.demo; installed=$$?; wait $$building; exit $$installed
	$(COMPILE) --only verdicts robots fits paper
	$(BIN)/python examples/demo.py

test: $(VENV)/.dev
	$(BUILD)
	$(COMPILE)
	$(PYTEST) -n $(THREADS) --dist loadfile -m "not verify and not fuzz" tests

verify: $(VENV)/.dev
	$(BUILD)
	$(PYTEST) -s -m verify tests

fuzz: $(VENV)/.dev
	$(BUILD)
	$(COMPILE)
	$(PYTEST) -s -n $(THREADS) -m fuzz tests/fuzz

# Compiled code of its own: Numba puts a check before every access to an array.
bounds: export LOEWNER_JIT := 1
bounds: export NUMBA_BOUNDSCHECK := 1
bounds: $(VENV)/.dev
	$(COMPILE)
	$(PYTEST) -n $(THREADS) --dist loadfile -m "not verify and not fuzz" tests

bench: $(VENV)/.bench
	$(BUILD)
	$(BIN)/python benchmarks/fits.py
	$(BIN)/python benchmarks/run.py

check: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BUILD)
	$(COMPILE)
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

# What builds the native library; the rest can be installed meanwhile.
$(VENV)/.compiler: requirements/core.txt | $(BIN)/python
	$(PIP) --constraint requirements/core.txt numba
	@touch $@

$(VENV)/.core: requirements/core.txt pyproject.toml $(VENV)/.compiler
	$(PIP) -r requirements/core.txt
	LOEWNER_BUILD=pure $(PIP) --no-deps --editable .
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
