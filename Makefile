# The commands people type. `make check` is what CI runs.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt
OUT := out

.PHONY: help setup demo test check lint bench fuzz golden docs image clean

help:
	@echo "make setup   virtual environment in .venv, with everything for development"
	@echo "make demo    two minutes through a simulated city, replayed through all services; report in $(OUT)/demo"
	@echo "make test    all tests; what needs recordings or a container engine skips visibly"
	@echo "make check   lint, types, import rules, generated pages, tests: what CI runs"
	@echo "make bench   figures against their peers, into $(OUT)/bench.json"
	@echo "make fuzz    damaged input for every decoder, ten minutes; FUZZ_MINUTES=1 for less"
	@echo "make image   container image camber, with everything for any service"
	@echo "make golden  golden bytes of messages that are not released; make docs: generated pages"
	@echo "make clean   remove what was made, but .venv"

$(BIN)/python:
	$(PYTHON) -m venv .venv

# What running needs; redone when the requirements change.
.venv/.runtime: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) -e '.[simulator]'
	@touch $@

.venv/.development: .venv/.runtime
	$(PIP) -e '.[engine,localizer,map,fleet,web,simulator,dev]'
	@touch $@

setup: .venv/.development

demo: .venv/.runtime
	$(BIN)/camber demo --out $(OUT)/demo

# What runs in one process goes side by side; what starts processes, and waits for them, does not.
test: setup
	$(BIN)/python -m camber.gnss.warm_up # once, not once a worker
	$(BIN)/python -m pytest -n 2 --dist loadfile tests/architecture tests/contract tests/fuzz tests/unit
	$(BIN)/python -m pytest tests/integration tests/replay tests/container

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python -m camber.tools.data_flow --check

check: lint test

bench: setup
	$(BIN)/python benchmarks/run.py --out $(OUT)/bench.json

fuzz: setup
	PYTHONPATH=tests $(BIN)/python -m fuzz.run --minutes $(or $(FUZZ_MINUTES),10) --out $(OUT)/fuzz

golden: setup
	PYTHONPATH=tests $(BIN)/python -m contract.make_golden

docs: setup
	$(BIN)/python -m camber.tools.data_flow

image:
	docker build --file deploy/Dockerfile --build-arg PIP_INDEX_URL \
		--build-arg EXTRAS=engine,localizer,map,fleet,web,simulator --tag camber .

clean:
	rm -rf $(OUT) dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find schemas services tests -name __pycache__ -type d -prune -exec rm -rf {} +
