# `make demo`, `make test` and `make docs` need Python 3.11 or newer, pip and make, and set up the rest in .venv themselves.
# PYTHON=/path/to/python chooses the interpreter of a new .venv.

BIN := .venv/bin
LOCKED := pyproject.toml requirements/install.sh $(wildcard requirements/lock-*.txt)

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow check docs format lock clean

help:  ## List these targets
	@grep -E '^[a-z-]+:.*##' Makefile | sed -E 's/:.*## /\t/' | expand -t 14

demo: .venv/runtime.stamp  ## Sweep a coarse slice of basins of attraction: results/quick_basins (minutes)
	$(BIN)/gaitsweep run sweeps/quick_basins.yaml

test: .venv/dev.stamp  ## Run the test suite
	$(BIN)/python -m pytest

test-slow: .venv/dev.stamp  ## Run the tests that take longer
	$(BIN)/python -m pytest -m slow

check: .venv/dev.stamp  ## Lint, format, types, and the direction of imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports

docs: .venv/dev.stamp  ## Build the documentation: build/docs/html/index.html (half a minute)
	$(BIN)/python -m sphinx -W --keep-going -n -q -j auto -b html -c docs -d build/docs/doctrees . build/docs/html

format: .venv/dev.stamp  ## Format the sources and mend what lint can mend
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

lock: .venv/dev.stamp  ## Renew the pinned versions of every supported Python (PACKAGE=name: of one package)
	bash requirements/lock.sh $(PACKAGE)

clean:  ## Remove the environment and everything that was generated but results/
	rm -rf .venv build dist .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/runtime.stamp: $(LOCKED)
	@bash requirements/install.sh runtime
	@touch $@

.venv/dev.stamp: $(LOCKED)
	@bash requirements/install.sh dev
	@touch $@ .venv/runtime.stamp
