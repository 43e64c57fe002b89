# `make help` lists every target. Nothing but Python 3.11-3.13, make and git is needed beforehand.
SHELL := /bin/bash
.DEFAULT_GOAL := help

PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	command -v $$p >/dev/null 2>&1 && $$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null && echo $$p && break; done)
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
LOCKS := requirements/runtime.txt requirements/scan.txt requirements/dev.txt

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "cablejax needs Python 3.11, 3.12 or 3.13 on the PATH (or PYTHON=/path/to/python)." >&2; exit 2; }
	@echo "Creating $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.run-stamp: requirements/scan.txt pyproject.toml | $(BIN)/python
	@test -e $(VENV)/.dev-stamp || echo "Installing the locked dependencies (a minute or two)"
	@test -e $(VENV)/.dev-stamp || $(PIP) install --require-hashes -r $<
	@$(PIP) install --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.dev-stamp: requirements/dev.txt pyproject.toml | $(BIN)/python
	@echo "Installing the locked development dependencies (a minute or two)"
	@$(PIP) install --require-hashes -r $<
	@$(PIP) install --no-deps --no-build-isolation -e .
	@touch $@ $(VENV)/.run-stamp

.PHONY: help setup setup-dev lock
help: ## List every target
	@grep -hE '^[a-zA-Z0-9_-]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  %-22s %s\n", $$1, $$2}'

setup: $(VENV)/.run-stamp ## Create .venv with what `make run` needs

setup-dev: $(VENV)/.dev-stamp ## Create .venv with everything: tests, linters, notebooks, sweeps

COMPILE := $(BIN)/uv pip compile pyproject.toml --python-version 3.11 --universal --generate-hashes \
	--no-emit-index-url --no-emit-find-links --no-annotate --no-header --quiet
lock: $(VENV)/.dev-stamp ## Resolve the locks in requirements/ anew (UPGRADE=1 to move versions)
	$(COMPILE) $(if $(UPGRADE),--upgrade) --all-extras --group build --group dev -o requirements/dev.txt
	$(COMPILE) --group build -c requirements/dev.txt -o requirements/runtime.txt
	$(COMPILE) --group build --extra scan -c requirements/dev.txt -o requirements/scan.txt
