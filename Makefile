# Every target prepares what it needs: a fresh clone and Python >= 3.11 are enough.
# Another interpreter: make demo PYTHON=/path/to/python3

PYTHON ?= $(firstword $(foreach name,python3 python3.14 python3.13 python3.12 python3.11,$(shell \
  $(name) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $(name))))
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/atoll-installed
PROGRAM := $(VENV)/atoll-program-installed
DOCS := $(VENV)/atoll-docs-installed
BROWSER := $(VENV)/atoll-browser-installed
# An environment without an interpreter was not removed completely, and has nothing installed.
$(if $(wildcard $(BIN)/python),,$(shell rm -f $(STAMP) $(PROGRAM) $(DOCS) $(BROWSER)))

.DEFAULT_GOAL := help
.PHONY: help demo test test-all test-wheel kernels check pyright soak bench compare figures docs browser lock release-rehearsal deploy-rehearsal judge clean

help:
	@echo "make demo    find the two equations of a Lotka-Volterra system, on two workers"
	@echo "make test    what a change must pass: all tests but the slow ones"
	@echo "make test-all   these, too: whole pages of the documentation, machines that fail, statistics over seeds"
	@echo "make test-wheel  all tests against the wheel, in an environment of its own"
	@echo "make check   style, formatting, types, import contracts"
	@echo "make pyright types by a second checker, two minutes; needs Node.js"
	@echo "make soak    schedules of faults, simulated, on all cores, and drawn tables with drawn options:"
	@echo "             make soak SCHEDULES=10000 CASES=10000"
	@echo "make bench   the short benchmarks; benchmarks/RESULTS.md has the long ones"
	@echo "             with STROGATZ=folder also the label files there"
	@echo "make compare REVISION=v0.1.0   quick benchmarks of this tree and of another revision in turn, ten minutes:"
	@echo "             times, ratios, digests; also OTHER=revision MINUTES=5 ROUNDS=1 STROGATZ=folder ONLY=name"
	@echo "             RESULTS=1: sixty small jobs instead, compared in all that is written and printed; or once"
	@echo "             make compare RECORD=file (continues if the file exists), and later make compare AGAINST=file"
	@echo "make judge   refine 129 stored pools again: right forms, grades and seconds next to the reference, under ten minutes;"
	@echo "             with TABLES=folder REAL=folder also the tables there; ACCEPT=1 writes the reference anew"
	@echo "make figures STROGATZ=folder DYSTS=folder   measure again what README and docs quote, about 100 minutes;"
	@echo "             QUICK=1 few seeds, half an hour; MINUTES=35 a bound; then python -m benchmarks.figures quote"
	@echo "make docs    the documentation as a site, site/index.html, to be read without network"
	@echo "make browser the site and reports in Chromium: no network, readable by everybody, printable"
	@echo "make lock    the newest versions of the development tools into requirements-dev.txt"
	@echo "make release-rehearsal   build, check, install and sign a release without publishing it"
	@echo "make deploy-rehearsal    run what deploy/ describes: STEPS='compose slurm', WORK=folder, INSTALL=1 (as root)"
	@echo "make clean   remove the environment, caches and build products"

$(BIN)/python:
	@$(if $(PYTHON),$(PYTHON),false) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || \
	  { echo "make: Atoll needs Python 3.11 or newer; install one, or name it: make $(MAKECMDGOALS) PYTHON=/path/to/python3"; exit 1; }
	@echo "preparing $(VENV) with $$($(PYTHON) --version) (once)"
	@$(PYTHON) -m venv $(VENV)

# The program and its page, without the tools: half of the time and of the space. The versions are those of the tools' list.
$(PROGRAM): pyproject.toml requirements-dev.txt | $(BIN)/python
	@echo "installing Atoll into $(VENV) (once, about half a minute)"
	@sed -n 's/^\([A-Za-z0-9].*==[^\\]*\).*/\1/p' requirements-dev.txt > $(VENV)/versions.txt
	@$(BIN)/python -m pip install -q --disable-pip-version-check --constraint $(VENV)/versions.txt -e '.[web]'
	@touch $@

$(STAMP): pyproject.toml requirements-dev.txt | $(BIN)/python
	@echo "installing Atoll and its tools into $(VENV) (once, about a minute)"
	@$(BIN)/python -m pip install -q --disable-pip-version-check --require-hashes -r requirements-dev.txt
	@$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[dev]'
	@touch $@

demo: $(or $(wildcard $(STAMP)),$(PROGRAM))
	@$(BIN)/python -m examples.demo

# Some tests wait for processes, so there are three at a time for two cores; the tests of one file run one after the
# other. Each worker more takes ten seconds of a processor, for imports, collection and kernels.
# Files begin in their order, integration first: those few long tests would otherwise be what is left at the end.
AT_A_TIME = $(shell $(BIN)/python -c 'import os; from atoll_core.machine import usable_cores as cores; \
  print((3 * cores(os.environ)[0] + 1) // 2)')
PYTEST = $(BIN)/pytest -n $(AT_A_TIME) --dist loadfile --no-loadscope-reorder

test: $(STAMP)
	@$(BIN)/python -m tests.kernels --generic
	@$(PYTEST) -m "not slow"

test-all: $(STAMP)
	@$(BIN)/python -m tests.kernels --generic
	@$(PYTEST)

# Against the wheel in a separate environment, next to a foreign package `common`; also with options of pytest in WORDS.
test-wheel: $(STAMP) kernels
	@$(BIN)/python -m tests.wheel -n $(AT_A_TIME) --dist loadfile $(WORDS)

# Compiled before the first test, whose time is limited.
kernels: $(STAMP)
	@$(BIN)/python -m tests.kernels

check: $(STAMP)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check --quiet . || { echo "formatting differs; run: $(BIN)/ruff format ."; exit 1; }
	@$(BIN)/mypy
	@$(BIN)/lint-imports

# Beside mypy, which every change must pass: it takes longer, and is fetched from npm.
pyright: $(STAMP)
	@npx --yes pyright@1.1.414 --pythonpath $(BIN)/python

SCHEDULES ?= 1000
CASES ?= 10000
# Goes on where it was interrupted; remove build/pipelines.jsonl to begin anew.
soak: $(STAMP) kernels
	@$(BIN)/python -m tests.simulation.soak --schedules $(SCHEDULES)
	@$(BIN)/python -m tests.simulation.every_method
	@$(BIN)/python -m benchmarks.operations.files --cases 5000
	@$(BIN)/python -m benchmarks.operations.pipelines --cases $(CASES) --out build/pipelines.jsonl

bench: $(STAMP)
	@$(BIN)/python -m benchmarks.kernels.elementary
	@$(BIN)/python -m benchmarks.kernels --rows 128 --repetitions 3
	@$(BIN)/python -m benchmarks.paper.table3 --derivatives given --seeds 0 --max-time 60
	@$(BIN)/python -m benchmarks.noise --seeds 0 --levels 0 0.05
	@$(BIN)/python -m benchmarks.paper.table1 --seeds 0-4 || test $$? = 1
	@$(BIN)/python -m benchmarks.operations.scaling --system lotka_volterra --epochs 4 --seeds 0
	@test -z "$(STROGATZ)" || $(BIN)/python -m benchmarks.peers.strogatz --data "$(STROGATZ)" --noise 0 --seeds 0 --max-time 30
	@test -z "$(STROGATZ)" || $(BIN)/python -m benchmarks.peers.strogatz --data "$(STROGATZ)" --seeds 0 --noise 0.001 --max-time 5

# Fails when a digest differs; with RESULTS, RECORD or AGAINST, when anything does.
COMPARISON = $(if $(RESULTS)$(RECORD)$(AGAINST),same_results,side_by_side)
compare: $(STAMP)
	@test -n "$(REVISION)$(RECORD)$(AGAINST)" || { echo "make compare: name a commit, a tag or a branch: make compare REVISION=v0.1.0"; exit 2; }
	@$(BIN)/python -m benchmarks.operations.$(COMPARISON) $(if $(REVISION),"$(REVISION)") \
	  $(if $(OTHER),--other "$(OTHER)") $(if $(RECORD),--record "$(RECORD)") $(if $(AGAINST),--against "$(AGAINST)") \
	  $(if $(MINUTES),--minutes "$(MINUTES)") $(if $(ROUNDS),--rounds "$(ROUNDS)") \
	  $(if $(STROGATZ),--strogatz "$(STROGATZ)") $(if $(ONLY),--only "$(ONLY)")

# Fails when fewer equations are right than before, or more grades promise what does not hold, beyond chance.
judge: $(STAMP) kernels
	@$(BIN)/python -m benchmarks.pools judge --workers 2 $(if $(TABLES),--cases "$(TABLES)") \
	  $(if $(REAL),--real "$(REAL)") $(if $(ACCEPT),--accept) $(if $(ONLY),--only $(ONLY))

# Goes on where it was interrupted. Fails where a figure could not be measured, or not to its end.
figures: $(STAMP)
	@$(BIN)/python -m benchmarks.figures measure $(if $(STROGATZ),--strogatz "$(STROGATZ)") \
	  $(if $(DYSTS),--dysts "$(DYSTS)") $(if $(QUICK),--quick) $(if $(MINUTES),--minutes "$(MINUTES)")

# One file for all systems and versions of Python, with hashes; what is packaged keeps its ranges.
$(DOCS): $(STAMP)
	@$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[docs]'
	@touch $@

docs: $(DOCS)
	@$(BIN)/python docs/build_site.py site
	@echo "site/index.html"

$(BROWSER): $(DOCS)
	@$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[browser]'
	@touch $@

browser: $(BROWSER) docs
	@$(BIN)/pytest tests/integration/test_browser.py tests/integration/test_web_browser.py \
	  tests/integration/test_web_keyboard.py tests/integration/test_web_newcomers.py \
	  tests/integration/test_web_tabs.py tests/integration/test_web_proxies.py --site site

lock: $(STAMP)
	@$(BIN)/python -m pip install -q --disable-pip-version-check uv
	@$(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.11 --generate-hashes --extra dev \
	  --custom-compile-command "make lock" --output-file requirements-dev.txt pyproject.toml

release-rehearsal: $(STAMP)
	@$(BIN)/python -m deploy.release

WORK ?= build/deploy-rehearsal
deploy-rehearsal: $(STAMP)
	@$(BIN)/python -m deploy.rehearsal $(STEPS) --work $(WORK) $(if $(INSTALL),--install)

clean:
	@rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
