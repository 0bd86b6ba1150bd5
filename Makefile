# Every target makes its own environment in .venv when there is none; `make PYTHON=python3.12 ...` chooses the interpreter.

PYTHON ?= python3
BIN := .venv/bin
DEMO := build/demo

# Without a C compiler, one from PyPI comes along.
COMPILER := $(if $(shell command -v cc || command -v gcc || command -v clang),,compiler)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: help demo test lint validate mutate bench reproduce docs clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "%-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: .venv/.installed  ## drive a series hybrid over US06, as an FMU, and plot it in build/demo
	@mkdir -p $(DEMO)
	$(BIN)/halfshaft fmu small-car-series --fmi 3 -o $(DEMO)/small-car-series.fmu
	$(BIN)/halfshaft run small-car-series --cycle us06 --via fmu3 --plot $(DEMO)/us06.png

test: .venv/.installed-dev  ## run the tests
	$(BIN)/python -m pytest -n 2 --dist worksteal tests

lint: .venv/.installed-dev  ## check style, format and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy -p halfshaft

validate: .venv/.installed-dev  ## run the slow checks: against the forward-facing model, and of broken files
	$(BIN)/python -m pytest -n 2 validation

mutate: .venv/.installed-dev  ## change 200 places of the program, one at a time, and see which no test notices (hours)
	$(BIN)/python -m halfshaft.validation.mutate

bench: .venv/.installed-bench  ## time the step and compare it with FASTSim
	$(BIN)/halfshaft bench

reproduce: .venv/.installed  ## reproduce the tables and figures of the paper in build/reproduce
	$(BIN)/halfshaft reproduce --out build/reproduce

docs: .venv/.installed-docs  ## build the manual in build/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

clean:  ## remove what the other targets made, except .venv
	rm -rf build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find src library models fmu_build cosim studies validation app tests -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamps say what is installed; an environment without them, made by hand, is completed.
.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit("halfshaft needs Python 3.11 or newer: make PYTHON=..." if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv .venv || { rm -rf .venv; exit 1; }

.venv/.installed: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --editable .$(if $(COMPILER),[$(COMPILER)])
	@touch $@

.venv/.installed-%: .venv/.installed
	$(BIN)/python -m pip install --quiet --editable ".[$*]"
	@touch $@
