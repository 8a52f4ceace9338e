# Two commands are enough: `make run` and `make test`. Needs a Python (with venv), git and make; everything else goes into .venv.
# The first of these that there is and runs: a version manager leaves names of versions that are switched off.
PYTHON ?= $(or $(firstword $(foreach p,python3.11 python3.12 python3.13 python3.10,$(shell $(p) -c 'print("$(p)")' 2> /dev/null))),python3.11)
ARGS ?=
IMAGE ?= uwserver
BUILDER ?= docker
# More than a small machine has cores: many tests wait for a peer, or for a time to pass.
WORKERS ?= 3

# Tests start Python hundreds of times: byte code is kept, also where the environment says that none is written.
export PYTHONDONTWRITEBYTECODE =

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
READY := $(VENV)/.ready
# uv where it is there: it downloads and installs several times as fast as pip.
UV := $(shell command -v uv 2> /dev/null)
ifdef UV
MAKE_VENV = $(UV) venv --quiet --python $(PYTHON) $(VENV)
INSTALL = $(UV) pip install --quiet --python $(BIN)/python
else
MAKE_VENV = $(PYTHON) -m venv $(VENV)
# As uv does, byte code is left to the first import: most of the dialects of MAVLink are never imported.
INSTALL = $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check
endif

.DEFAULT_GOAL := help
.PHONY: help ready install run test test-all quick tests fuzz lint types docs-check wheels wheel-smoke other-pythons $(MORE) demo bench docs site dist image lock clean

help:  ## show this
	@sed -n 's/^\([a-z-]*\):.*##  *\(.*\)/  make \1\t\2/p' Makefile | expand -t 24

ready: $(READY)  ## create .venv with what running needs
$(READY): pyproject.toml clients/python/pyproject.toml
	@echo "installing what running needs into $(VENV), about 30 s ..."
	@test -x $(BIN)/python || $(MAKE_VENV)
	@$(INSTALL) -e ".[solid]" -e clients/python
	@touch $@

# MAVProxy is a peer of the tests, and needs neither vtk nor OpenCV of its windows.
install: $(STAMP)  ## add what tests, benchmarks and documents need, and compile all of the physics
$(STAMP): $(READY) bench/pyproject.toml
	@echo "installing what development needs into $(VENV), some minutes ..."
	@$(INSTALL) -e ".[solid,docs,dev]" -e bench -e clients/python
	@$(INSTALL) --no-deps "MAVProxy>=1.8.71"
	@$(BIN)/python -m uwserver.world.warm
	@touch $@

run: ready  ## start the default scenario on port 7600 (ARGS="my.toml --port 0" for another)
	@exec $(BIN)/uwserver run $(ARGS)

# Of `make test`, each a target of its own; then what `make test-all` adds, in parts of at most half an hour.
PARTS = lint types tests docs-check wheel-smoke other-pythons
MORE = slow-unit slow-examples slow-ways slow-ways-paced slow-ways-driven slow-ways-kept slow-served slow-soak slow-fuzz slow-image docs-check-all wheel-smoke-all other-pythons-all
FIGURES = build/tests
PYTEST = $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -q --junitxml $(FIGURES)/$@.xml

test: install  ## everything that must hold before a change is taken; prints what each part took
	@$(BIN)/python tools/run_parts.py $(PARTS)

# A run that was broken off goes on where it was, as long as no file has changed.
test-all: install  ## the same and, part by part, what takes long: every variant, container, long fuzz, peers built for the test
	@$(BIN)/python tools/run_parts.py --kept build/test-all.json $(PARTS) $(MORE)

CHANGED = { git diff --name-only HEAD; git ls-files --others --exclude-standard; }

quick: install  ## between two edits: ruff, the rules of the house, and the tests of the rooms with changes that are not committed
	$(BIN)/ruff check --quiet .
	$(BIN)/ruff format --check --quiet .
	$(BIN)/python -m pytest -q -x -n 2 --dist worksteal -m "not slow" tests/house $$($(CHANGED) | xargs $(BIN)/python tools/rooms.py)

tests: install
	$(PYTEST) -m "not slow" tests

slow-unit: install
	$(PYTEST) -m slow tests/unit tests/house tests/physics tests/conformance

slow-examples: install
	$(PYTEST) -m slow tests/examples

# All ways to step a world, over a hundred thousand ticks each: of the scenarios but the one that has everything, and of that one in three parts.
slow-ways: install
	$(PYTEST) -m slow tests/determinism -k "not one_of_everything"

slow-ways-paced: install
	$(PYTEST) -m slow tests/determinism -k "one_of_everything and long_way and (paused or free or real)"

slow-ways-driven: install
	$(PYTEST) -m slow tests/determinism -k "one_of_everything and long_way and not (paused or free or real)"

slow-ways-kept: install
	$(PYTEST) -m slow tests/determinism -k "one_of_everything and not long_way"

slow-served: install
	$(PYTEST) -m slow tests/integration --ignore=tests/integration/test_image.py

slow-soak: install
	$(PYTEST) -m slow tests/soak

slow-fuzz: install
	$(PYTEST) -m slow tests/fuzz

slow-image: install
	$(PYTEST) -m slow tests/integration/test_image.py

fuzz: install  ## ten million inputs for each codec (hours)
	UWSERVER_FUZZ_INPUTS=10000000 $(BIN)/python -m pytest -m slow tests/fuzz/test_codecs_fuzz.py -n $(WORKERS)

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: install
	$(BIN)/mypy
	cd clients/python && ../../$(BIN)/pyright --pythonpath ../../$(BIN)/python

docs-check: install
	$(BIN)/python tools/reference_docs.py --check
	$(BIN)/python tools/validation_report.py --check
	$(BIN)/python tools/vehicle_pages.py --check

docs-check-all: install
	$(BIN)/python tools/reference_docs.py --check
	$(BIN)/python tools/validation_report.py --check --all
	$(BIN)/python tools/vehicle_pages.py --check --all

wheels: install  ## build source distributions and wheels of this checkout, once for what is in it, and say where they are
	@$(BIN)/python tools/wheels.py

wheel-smoke: wheels  ## use what the wheels bring in a fresh environment
	$(BIN)/python tools/wheel_smoke.py

wheel-smoke-all: wheels  ## the same with all dependencies installed and no kernel there, and the page in Chromium where it is installed (pictures: build/page)
	$(BIN)/python tools/wheel_smoke.py --dependencies --page --pictures build/page

other-pythons: wheels  ## try what can differ with CPython 3.10, 3.12 and 3.13, as far as they are on this machine
	$(BIN)/python tools/other_pythons.py

other-pythons-all: wheels
	$(BIN)/python tools/other_pythons.py --all

demo: install  ## drive a 5 m square by feedback on the simulated sensors and draw it
	$(BIN)/python tools/demo.py $(ARGS)

bench: install  ## measure speed and latency beside the peers
	$(BIN)/uwserver bench $(ARGS)

docs: install  ## regenerate the generated pages of docs/ and the JSON Schemas of scenario files
	$(BIN)/python tools/reference_docs.py
	$(BIN)/python tools/validation_report.py
	$(BIN)/python tools/vehicle_pages.py

site: install  ## build the documentation as a site into build/site; a link that leads nowhere is an error
	$(INSTALL) -e ".[site]" -e clients/python
	$(BIN)/python tools/site.py

dist: install  ## build what is published into dist/, and check it: wheels with kernels for each CPython that is here (ARGS="--python python3.11" for one, "--release --bars")
	$(INSTALL) -e ".[release]" -e clients/python
	$(BIN)/python tools/dist.py $(ARGS)

# Podman's own format has no health check.
image:  ## build the container image (BUILDER=podman, IMAGE=name, ARGS="--build-arg BASE=...")
	$(BUILDER) build $(if $(filter podman buildah,$(notdir $(BUILDER))),--format docker) -t $(IMAGE) $(ARGS) .

lock:  ## pin what the image holds in requirements.lock (needs uv; ARGS=--upgrade for the newest versions)
	$(PYTHON) tools/lock.py $(ARGS)

clean:  ## remove .venv and everything built
	rm -rf $(VENV) build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find uwserver bench adapters scenarios clients tests tools -name __pycache__ -type d -prune -exec rm -rf {} +
