# The commands people type. `make check` is what CI runs.
PYTHON ?= python3
BIN := .venv/bin
# What is there stays, whatever python3 is today, until PYTHON asks for another or it runs no more.
VERSION := $(shell for python in $(if $(filter file,$(origin PYTHON)),$(BIN)/python) $(PYTHON); do \
	$$python -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null && break; done)
MADE := .venv/.made-$(VERSION)
# Without --compile: byte code is made of what is imported, and not of all that is installed. The constraints are no
# option, since they hold for what builds are made with, too: pip before 25.3 knows the first name, later ones the second.
PIP := PIP_CONSTRAINT=constraints.txt PIP_BUILD_CONSTRAINT=constraints.txt \
	$(BIN)/pip install --quiet --disable-pip-version-check --no-compile
OUT := out
# The extras that images install.
SHIPPED := engine,localizer,map,fleet,plots,web,foxglove,simulator,ros
# Tests start hundreds of processes: without byte code each of them compiles all that it imports, for seconds.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup demo evidence compile compile-engine compile-localizer compile-maps compile-simulator test check lint bench fuzz mutation promises faults soak hostile golden docs docs-site image sbom licences vulnerabilities clean

help:
	@echo "make setup   virtual environment in .venv, with everything for development"
	@echo "make demo    two minutes through a simulated city, replayed through all services; report in $(OUT)/demo"
	@echo "make test    all tests; what needs recordings or a container engine skips visibly"
	@echo "make check   lint, types, import rules, generated pages, tests: what CI runs"
	@echo "make bench   figures against their peers, into $(OUT)/bench.json"
	@echo "make evidence  drives through all services, and docs/evidence.md; the recording needs CAMBER_DATA; an hour"
	@echo "make fuzz    damaged input for every decoder, ten minutes; FUZZ_MINUTES=1 for less, FUZZ_SEED=n as then"
	@echo "make mutation  thousands of small changes of the judge, each of which a test must notice; an hour and a half, MODULE=learning some minutes"
	@echo "make promises  each safety promise broken in a copy of the sources, which its test must notice; ten minutes"
	@echo "make faults  outages as long as they are promised for, links cut for ten minutes among them; half an hour, as root"
	@echo "make soak    two hours of driving in real time: memory, descriptors, threads, latency; SOAK_MINUTES=5 for less"
	@echo "make hostile  a million malformed messages to every input of a driving vehicle; HOSTILE_COUNT=20000 for less"
	@echo "make image   container image camber, with everything for any service"
	@echo "make sbom    bill of materials of what images install, CycloneDX, into $(OUT)/sbom.json"
	@echo "make licences  licences of all packages; fails on one that may not be shipped"
	@echo "make vulnerabilities  known vulnerabilities of all packages, by osv.dev"
	@echo "make golden  golden bytes of messages that are not released; make docs: generated pages"
	@echo "make docs-site  all pages, the Python API and the command line as a site in $(OUT)/docs-site, for reading without a network"
	@echo "make clean   remove what was made, but .venv"

# Marked when it is whole: what ended halfway is begun anew.
$(MADE):
	$(PYTHON) -m venv --clear .venv
	@touch $@

# What running needs; redone when the requirements change.
.venv/.runtime: pyproject.toml constraints.txt $(MADE)
	$(PIP) -e '.[localizer,plots,simulator,web]'
	@touch $@

.venv/.development: pyproject.toml constraints.txt $(MADE)
	$(PIP) -e '.[$(SHIPPED),dev,docs]'
	@touch .venv/.runtime $@

.venv/.mutation: pyproject.toml constraints.txt $(MADE) | .venv/.development
	$(PIP) -e '.[mutation]'
	@touch .venv/.runtime .venv/.development $@

setup: .venv/.development

# With anything else asked for at once it takes what that needs: two of pip at a time would be in each other's way.
demo: $(if $(filter-out demo,$(MAKECMDGOALS)),.venv/.development,.venv/.runtime)
	$(BIN)/camber demo --out $(OUT)/demo

# Machine code is made once, before any worker needs it.
compile: compile-engine compile-simulator compile-localizer compile-maps

compile-engine: setup
	$(BIN)/python -m camber.gnss.warm_up

compile-localizer: setup
	$(BIN)/python -m camber.localizer.warm_up

compile-maps: setup
	$(BIN)/python -m camber.map_server.warm_up
	$(BIN)/python -m camber.map_update.warm_up

# Into a folder of its own: two of make may do this at once, as in CI.
compile-simulator: setup
	folder=$$(mktemp -d) && trap 'rm -rf "$$folder"' EXIT && \
		$(BIN)/camber simulate city --set duration_s=0.5 --set lidar.beams=32 --out "$$folder/city" --quiet

# Tests of processes wait most of the time, so five run at once; others two at once. What compares with the clock (the
# marker `timed`) comes last, three files at once: each uses a quarter of a processor. The judge's pure modules must be
# covered whole by their own tests; those of many drives (the marker `slow`) run without counting lines, twice as fast.
define TESTS
$(BIN)/python -m pytest -n 5 --dist loadfile --no-loadscope-reorder -m 'not timed' tests/integration tests/container tests/web
$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m 'not timed' --ignore tests/unit/integrity \
	tests/replay tests/architecture tests/contract tests/fuzz tests/unit
$(BIN)/python -m pytest -n 2 --dist load -m 'not slow' tests/unit/integrity --cov
$(BIN)/python -m pytest -n 2 --dist load -m slow tests/unit/integrity
$(BIN)/python -m pytest -n 3 --dist loadfile -m timed tests/integration tests/container
endef

test: compile
	$(TESTS)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -c "import camber; from importlinter.cli import lint_imports_command as run; run()" --no-cache
	$(BIN)/python -m camber.tools.generate_docs --check
	$(MAKE) docs-site
	$(MAKE) licences >/dev/null

# Types are checked by one processor while the other compiles.
check: setup
	$(MAKE) --jobs 2 --output-sync=target compile lint
	$(TESTS)

bench: setup
	$(BIN)/python benchmarks/run.py --out $(OUT)/bench.json

evidence: setup
	$(BIN)/camber evidence --out $(OUT)/evidence --lab $(OUT)/lab/lab.json --page docs/evidence.md

fuzz: setup
	PYTHONPATH=tests $(BIN)/python -m fuzz.run --minutes $(or $(FUZZ_MINUTES),10) $(if $(FUZZ_SEED),--seed $(FUZZ_SEED)) --out $(OUT)/fuzz

mutation: setup .venv/.mutation
	PYTHONPATH=tests $(BIN)/python -m mutation.run $(if $(MODULE),--only $(MODULE)) --out $(OUT)/mutation

promises: compile
	PYTHONPATH=tests $(BIN)/python -m mutation.promises

faults: compile
	rm -f $(OUT)/faults/recovery.jsonl
	FAULTS=long FAULTS_OUT=$(abspath $(OUT))/faults/recovery.jsonl $(BIN)/python -m pytest -m slow tests/integration/test_faults_*.py
	@cat $(OUT)/faults/recovery.jsonl

soak: compile
	PYTHONPATH=tests $(BIN)/python -m soak.run --minutes $(or $(SOAK_MINUTES),120) --out $(OUT)/soak

hostile: compile
	PYTHONPATH=tests $(BIN)/python -m hostile.run --count $(or $(HOSTILE_COUNT),1000000) $(if $(HOSTILE_SEED),--seed $(HOSTILE_SEED)) --out $(OUT)/hostile

golden: setup
	PYTHONPATH=tests $(BIN)/python -m contract.make_golden

docs: setup
	$(BIN)/python -m camber.tools.generate_docs

docs-site: setup
	$(BIN)/python -m camber.tools.generate_docs.site --out $(OUT)

image:
	docker build --file deploy/Dockerfile --build-arg PIP_INDEX_URL --build-arg PYTHON_IMAGE --build-arg KIND=compiled \
		--build-arg EXTRAS=$(SHIPPED) --tag camber .

# The auditing tools have an environment of their own: what they audit is without them.
.venv/audit/.made: constraints.txt pyproject.toml $(MADE)
	$(PYTHON) -m venv --clear .venv/audit
	PIP_CONSTRAINT=constraints.txt .venv/audit/bin/pip install --quiet --disable-pip-version-check \
		cyclonedx-bom pip-audit pip-licenses
	@touch $@

sbom: .venv/audit/.made
	$(PYTHON) -m venv --clear $(OUT)/shipped
	PIP_CONSTRAINT=constraints.txt PIP_BUILD_CONSTRAINT=constraints.txt $(OUT)/shipped/bin/pip install --quiet \
		--disable-pip-version-check --no-compile '.[$(SHIPPED)]'
	$(OUT)/shipped/bin/pip uninstall --quiet --yes pip setuptools
	.venv/audit/bin/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible \
		--output-file $(OUT)/sbom.json $(OUT)/shipped/bin/python

# The licences that may be shipped are in pyproject.toml.
licences: setup .venv/audit/.made
	.venv/audit/bin/pip-licenses --python $(BIN)/python
	$(BIN)/python deploy/bundled_licences.py

vulnerabilities: .venv/audit/.made
	.venv/audit/bin/pip-audit --strict --vulnerability-service osv --no-deps --disable-pip --requirement constraints.txt

clean:
	rm -rf $(OUT) dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find schemas services tests -name __pycache__ -type d -prune -exec rm -rf {} +
