# Two commands are enough: `make run` and `make test`. Needs a Python (with venv), git and make; everything else goes into .venv.
# The first of these that there is and runs: a version manager leaves names of versions that are switched off.
PYTHON ?= $(or $(firstword $(foreach p,python3.11 python3.12 python3.13 python3.10,$(shell $(p) -c 'print("$(p)")' 2> /dev/null))),python3.11)
ARGS ?=
IMAGE ?= uwserver
BUILDER ?= docker
WORKERS ?= 2
FUZZ_SECONDS ?= 60

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
.PHONY: help ready install run test parts test-all fast-tests all-tests fuzz lint types docs-check wheel-smoke other-pythons demo bench docs site dist image lock clean

help:  ## show this
	@sed -n 's/^\([a-z-]*\):.*##  *\(.*\)/  make \1\t\2/p' Makefile | expand -t 22

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

PARTS = lint types fast-tests docs-check wheel-smoke other-pythons
test: $(PARTS)  ## everything that .ci/run checks

parts:
	@echo install $(PARTS)

test-all: lint types all-tests docs-check  ## the same and the slow tests: container, long fuzz, peers built for the test
	$(BIN)/python tools/wheel_smoke.py --dependencies

fast-tests: install
	# In two runs, as a worker keeps what it compiles: together they would take twice the memory.
	UWSERVER_FUZZ_SECONDS=$(FUZZ_SECONDS) $(BIN)/python -m pytest -m "not slow" -n $(WORKERS) tests/unit
	UWSERVER_FUZZ_SECONDS=$(FUZZ_SECONDS) $(BIN)/python -m pytest -m "not slow" -n $(WORKERS) tests --ignore=tests/unit

fuzz: install  ## ten million inputs for each codec (hours)
	UWSERVER_FUZZ_INPUTS=10000000 $(BIN)/python -m pytest -m slow tests/fuzz/test_codecs_fuzz.py -n $(WORKERS)

all-tests: install
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile

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

wheel-smoke: install  ## use what the wheels bring in a fresh environment, and drive their page where Chromium is installed (pictures: build/page)
	$(BIN)/python tools/wheel_smoke.py --page --pictures build/page

other-pythons: install  ## try CPython 3.10, 3.12 and 3.13, as far as they are on this machine
	$(BIN)/python tools/other_pythons.py

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

dist: install  ## build what is published into dist/, and check it (ARGS="--python python3.10 --python python3.11 --release --bars")
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
