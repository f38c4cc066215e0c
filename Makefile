# Every target sets up .venv by itself; PYTHON chooses the interpreter (3.11 or newer).
PYTHON ?= python3
VENV := .venv
USE := $(VENV)/use
BENCH := $(VENV)/bench
READY := $(VENV)/ready
PEERS := $(VENV)/peers
BIN := $(VENV)/bin

.DEFAULT_GOAL := help
.PHONY: help setup demo bench reports attacks test test-all mutants lint docs dist clean

help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-8s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: $(READY)  ## .venv with steerkit and all that its development needs

demo: $(USE)  ## three cars learn to steer, are compared with Stanley; table and figures under runs/
	$(BIN)/steerkit demo

bench: $(BENCH)  ## learned against analytic controllers, a selection of some minutes; report under runs/benchmarks/quick
	$(BIN)/python -m benchmarks run quick
	$(BIN)/python -m benchmarks report runs/benchmarks/quick

reports: $(PEERS)  ## every suite in full, some three hours of computing; pages under runs/reports
	for suites in "paper tracking learning-curve" robustness adapt generalise peers; do \
		$(BIN)/python -m benchmarks run $$suites --out runs/reports/$${suites%% *} && \
		$(BIN)/python -m benchmarks report runs/reports/$${suites%% *} || exit 1; done
	$(BIN)/python -m benchmarks run compute --jobs 1 --out runs/reports/compute
	$(BIN)/python -m benchmarks report runs/reports/compute

attacks: $(READY)  ## what an attacker on sensors, bus and client achieves against the car's checks; runs/attacks.md
	mkdir -p runs
	$(BIN)/python -m tests.attack.table > runs/attacks.md

test test-all: export OMP_NUM_THREADS = 1
# Tests start some hundred programs; without their bytecode each compiles the library anew, most of a second.
test test-all: export PYTHONDONTWRITEBYTECODE =
# They compile some two hundred loops; for a few seconds of driving, to optimise them or to inline
# (half of the time without optimising) takes longer than the driving.
test test-all: export CC := $(CC) -O0 -Dalways_inline=
# Who has done his share takes over from the others: a long test at the end holds nobody up.
test: $(READY)  ## all tests, on three processes: some wait for a car in real time
	$(BIN)/python -m pytest -n 3 --dist worksteal

BROWSER := $(firstword $(shell command -v chromium chromium-browser google-chrome chrome))

test-all: $(PEERS)  ## all tests, with do-mpc, Stable-Baselines3 and a browser too; names what is still skipped
	@echo "browser: $(or $(BROWSER),none; five tests need one: apt-get install chromium)"
	$(BIN)/python -m pytest -n 3 --dist worksteal -rs

MUTANTS ?=
mutants: $(READY)  ## change the code at random, in copies: does a test notice? MUTANTS="--all --count 200 --seed 1"
	$(BIN)/python -m tests.support.mutants $(MUTANTS)

lint: $(READY)  ## style, format and types
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

docs: $(READY)  ## the documentation site, under site/; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

dist: $(READY)  ## wheel and sdist under dist/, installed elsewhere and tested there
	rm -rf dist
	$(BIN)/python -m build --no-isolation
	$(BIN)/python tests/installed.py dist

clean:  ## remove .venv and caches (runs/ stays)
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .hypothesis build dist site *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Set up again whenever a dependency may have changed: what steerkit itself needs; the suites; all of the development.
$(USE): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	touch $@

$(BENCH): $(USE)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[bench]'
	touch $@

$(READY): $(USE)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

$(PEERS): $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,peers]'
	touch $@
