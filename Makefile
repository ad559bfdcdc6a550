# Everything runs from a virtual environment in .venv, made on first use.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
WORKERS ?= 2
VENV := .venv
RUN := $(VENV)/bin/python -m
PIP := $(RUN) pip install -qq --disable-pip-version-check --no-input
STAMP := $(VENV)/.installed
# The Khronos validator of glTF files, for the tests; without npm they are skipped.
GLTF := tests/io/validator/node_modules/.package-lock.json

# The official networks and meshes; without them the tests that need them are skipped.
NSM_DATA_DIR ?= $(abspath $(wildcard ../shared/data))
ifneq ($(NSM_DATA_DIR),)
export NSM_DATA_DIR
endif

.DEFAULT_GOAL := help
.PHONY: help demo test coverage nightly lint docs bench

help: ## show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-8s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(STAMP) ## train the default morph, two cylinders to a torus, into outputs/demo
	$(RUN) nsm.train hydra.run.dir=outputs/demo

test: $(STAMP) $(GLTF) ## run all tests (WORKERS=2 side by side, PYTEST_ARGS for pytest)
	$(RUN) pytest -q -n $(WORKERS) --dist worksteal $(PYTEST_ARGS)

coverage: $(STAMP) $(GLTF) ## run all tests and show the lines that none of them reaches (a quarter slower)
	$(RUN) pytest -q -n $(WORKERS) --dist worksteal --cov=nsm --cov-report=term-missing:skip-covered $(PYTEST_ARGS)

nightly: $(STAMP) $(GLTF) ## run all tests with all their tries, and write the table of docs/reliability.md (hours)
	NSM_NIGHTLY=1 $(RUN) pytest -q $(PYTEST_ARGS)

lint: $(STAMP) ## check style, types and the direction of imports
	$(RUN) ruff check .
	$(RUN) ruff format --check .
	$(RUN) mypy
	$(VENV)/bin/lint-imports

docs: $(STAMP) ## build the documentation site into site/, where any warning is an error
	NO_MKDOCS_2_WARNING=1 $(RUN) mkdocs build --strict

bench: $(STAMP) ## measure the speed of a training step and what else tools/bench_*.py measures
	@set -e; for tool in tools/bench_*.py; do echo "== $$tool"; $(VENV)/bin/python $$tool; done

$(GLTF): tests/io/validator/package-lock.json
	@if command -v npm >/dev/null; then npm ci --silent --no-fund --ignore-scripts --prefix tests/io/validator \
		|| echo "npm could not install the validator of glTF files" >&2; fi

$(STAMP): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "nsm needs Python 3.11 or newer and found none: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "nsm needs Python 3.11 or newer, and $(PYTHON) is %d.%d: make PYTHON=/path/to/python3.11" % sys.version_info[:2])'
	@echo "Installing the versions of constraints.txt into $(VENV): some minutes, once"
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) -c constraints.txt torch
	@$(PIP) -c constraints.txt -e '.[dev]'
	@touch $@
