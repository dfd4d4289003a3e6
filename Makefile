# Python 3.11+ and make are all it needs. Every target sets up what it uses in .venv.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
WORKERS ?= auto

# A comma would end the argument of a call.
LIVE := .[ros2,play]

# What `make dist` runs against the wheel, and the tools for it.
EXTRAS := control,ros2,play,campaign,plan,px4,gym
CORE_TESTS := tests/boundary tests/craft tests/model tests/data tests/recording \
	tests/test_docstring_examples.py
TEST_TOOLS := 'pytest>=8' 'pytest-xdist>=3.8' 'pytest-timeout>=2.3' 'hypothesis>=6.100' 'beartype>=0.19'

# uv takes a quarter of pip's time; .venv gets one unless it is in PATH. If uv cannot be installed,
# or cannot reach an index that only pip is configured for, pip does the work.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
define install
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@PATH="$$PATH:$(BIN)"; { command -v uv >/dev/null || $(PIP) uv; } \
		&& uv pip install --quiet --python $(BIN)/python -e $(1) || $(PIP) -e $(1)
	@touch $@
endef

.PHONY: help install dev live play demo test test-all test-browser lint format docs dist results-quick studies bench clean

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

install: $(VENV)/.installed  ## set up .venv with the package
$(VENV)/.installed: pyproject.toml
	$(call install,.)

dev: $(VENV)/.installed-dev  ## the same with the tools for development
$(VENV)/.installed-dev: pyproject.toml
	$(call install,'.[dev]')
	@touch $(VENV)/.installed

live: $(VENV)/.installed-live  ## set up .venv for live flights
$(VENV)/.installed-live: pyproject.toml
	$(call install,'$(LIVE)')
	@touch $(VENV)/.installed

play: $(VENV)/.installed-play  ## play air hockey against the craft, in the browser; ARGS="--level hard" passes options
	$(BIN)/airpuck play $(ARGS)
$(VENV)/.installed-play: pyproject.toml
	$(call install,'.[play]')
	@touch $(VENV)/.installed

demo: install  ## the whole workflow on simulated recordings, no download; ARGS as for play
	$(BIN)/airpuck demo --out demo $(ARGS)

test: dev  ## the quick tests, in minutes: while you work
	$(BIN)/python -m pytest -n $(WORKERS) -m "not slow" --hypothesis-profile quick --durations 15

test-all: dev  ## all tests but the studies and the browser; those in real time at the end, alone
	$(BIN)/python -m pytest -n $(WORKERS) -m "not realtime" --durations 15
	$(BIN)/python -m pytest -n 0 -m realtime $$(grep -rl --include='test_*.py' mark.realtime tests)

test-browser: dev  ## the pages in a real browser (Chromium of the distribution)
	$(BIN)/python -m pytest -m browser -n 0 tests/web/test_page.py tests/web/test_view.py

docs: dev  ## the site, in docs/_build/html; its notebooks run once and are cached
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html

dist: dev  ## wheel and sdist, tried in a fresh environment; licences of all dependencies: in dist/
	rm -rf dist build/dist
	$(BIN)/python -m build --outdir dist
	$(BIN)/python -m venv build/dist
	build/dist/bin/python -m pip install --quiet --disable-pip-version-check "$$(ls dist/*.whl)[$(EXTRAS)]"
	$(BIN)/pip-licenses --python build/dist/bin/python --format markdown --order license \
		--output-file dist/LICENCES.md
	build/dist/bin/python -m pip install --quiet --disable-pip-version-check $(TEST_TOOLS)
	build/dist/bin/airpuck --version
	build/dist/bin/python -m pytest -n 0 -m "not slow" --hypothesis-profile quick $(CORE_TESTS)

results-quick: dev  ## recompute tables of docs/results.md in a minute; which numbers no longer hold?
	$(BIN)/python studies/tables.py --check

studies: dev  ## the long studies; then ten minutes of the live loop on an otherwise idle machine
	$(BIN)/python -m pytest -m study -n $(WORKERS)
	$(BIN)/python studies/live_loop.py --duration 600

bench: dev  ## measure speed on the real recordings (minutes); see benchmarks/
	$(BIN)/python -m benchmarks

lint: dev  ## ruff and pyright
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: dev  ## let ruff rewrite what it can
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:  ## remove everything that make and the tools created
	rm -rf $(VENV) demo out dist build docs/_build docs/reference .pytest_cache .ruff_cache .hypothesis
