# `make demo` and `make test` set themselves up; `make` alone lists what there is.
SHELL := /bin/bash
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

PYTHON ?= $(shell command -v python3.11 || echo python3)
OUT ?= out/demo
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
LOCK_VENV := out/lock-venv
COMPILE = uv pip compile --quiet --generate-hashes --no-emit-index-url --no-emit-find-links --no-annotate --universal \
	--python-version 3.11 --custom-compile-command "make lock" pyproject.toml

.PHONY: help
help: ## list these targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-8s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

.PHONY: setup
setup: $(INSTALLED) ## make .venv with everything that is locked, and the system libraries it needs

$(INSTALLED): requirements.lock pyproject.toml scripts/check-python.sh scripts/system-libraries.sh
	scripts/check-python.sh "$(PYTHON)"
	test -x $(BIN)/python || "$(PYTHON)" -m venv $(VENV)
	@echo "Installing the locked packages into $(VENV) (1.6 GB on disk) ..."
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	scripts/system-libraries.sh $(BIN)/python
	$(BIN)/headsup compile
	touch $@

.PHONY: demo
demo: setup ## the whole loop on one street, into OUT; DATA=DIR sets the real pothole scans of DIR into it
	$(BIN)/headsup demo --out "$(OUT)" $(if $(DATA),--data "$(DATA)")

.PHONY: test
test: setup ## every test but the long proofs
	$(BIN)/pytest -n auto --dist loadfile -m "not soak"

.PHONY: check
check: setup ## lint, format, types and the architecture's import rules
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

.PHONY: soak
soak: setup ## the long proofs
	@$(BIN)/pytest -m soak || { status=$$?; [ $$status -eq 5 ] && echo "There is no long proof yet."; }

.PHONY: lock
lock: ## resolve pyproject.toml anew into both lock files
	command -v uv > /dev/null || { "$(PYTHON)" -m venv $(LOCK_VENV) && $(LOCK_VENV)/bin/pip install --quiet uv; }
	PATH="$$PATH:$(LOCK_VENV)/bin" $(COMPILE) --extra dev --output-file requirements.lock
	PATH="$$PATH:$(LOCK_VENV)/bin" $(COMPILE) --extra server --output-file requirements-server.lock

.PHONY: schema
schema: setup ## write contract/schema.json from the messages
	$(BIN)/python -m contract.schema

.PHONY: clean
clean: ## remove what was made here, .venv included
	rm -rf $(VENV) out dist build .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
