# Python 3.11+ and make are all it needs. Every target sets up what it uses in .venv.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
WORKERS ?= auto

# Planning belongs to the first commands of README.md. Air hockey is a distribution of its own, which
# requires the same version of airpuck. A comma would end the argument of a call.
HOCKEY := packages/airpuck-hockey
USE := -e '.[plan]' -e ./$(HOCKEY)
LIVE := -e '.[plan,ros2,pages]' -e ./$(HOCKEY)
DEV := -e '.[dev]' -e ./$(HOCKEY)

# What `make dist` runs against the wheel, and the tools for it.
EXTRAS := control ros2 pages play campaign plan px4 gym
CORE_TESTS := tests/boundary tests/craft tests/model tests/data tests/recording \
	tests/test_docstring_examples.py $(HOCKEY)/tests/test_public_names.py
# Or lowest-direct: the lowest versions that pyproject.toml allows.
RESOLUTION ?= highest
TEST_TOOLS := 'pytest>=8' 'pytest-xdist>=3.8' 'pytest-timeout>=2.3' 'hypothesis>=6.100' 'beartype>=0.19' \
	'pandas>=2.2'

# uv takes a quarter of pip's time; .venv gets one unless it is in PATH. If uv cannot be installed,
# or cannot reach an index that only pip is configured for, pip does the work.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
define install
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@PATH="$$PATH:$(BIN)"; { command -v uv >/dev/null || $(PIP) uv; } \
		&& uv pip install --quiet --python $(BIN)/python $(1) || $(PIP) $(1)
	@touch $@
endef

# Runs the core tests with the package that an environment has installed, not with src.
define test_installed
	@cd $(1) && env -u PYTHONPATH bin/python -c \
		"import airpuck as a, sys; print(a.__version__, a.__file__); sys.exit('site-packages' not in a.__file__)"
	env -u PYTHONPATH $(1)/bin/python -m pytest -n 0 -m "not slow" --hypothesis-profile quick $(CORE_TESTS)
endef

PROJECTS := pyproject.toml $(HOCKEY)/pyproject.toml

.PHONY: help install dev live play demo test test-all test-browser lint format docs notebooks dist dist-python results-quick studies bench clean

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

install: $(VENV)/.installed  ## set up .venv with airpuck, planning and air hockey
$(VENV)/.installed: $(PROJECTS)
	$(call install,$(USE))

dev: $(VENV)/.installed-dev  ## the same with the tools for development
$(VENV)/.installed-dev: $(PROJECTS)
	$(call install,$(DEV))
	@touch $(VENV)/.installed

live: $(VENV)/.installed-live  ## set up .venv for live flights
$(VENV)/.installed-live: $(PROJECTS)
	$(call install,$(LIVE))
	@touch $(VENV)/.installed

play: install  ## play air hockey against the craft, in the browser; ARGS="--level hard" passes options
	$(BIN)/airpuck play $(ARGS)

demo: install  ## the whole workflow on simulated recordings, no download; ARGS as for play
	$(BIN)/airpuck demo --out demo $(ARGS)

test: dev  ## the quick tests, in minutes: while you work
	$(BIN)/python -m pytest -n $(WORKERS) -m "not slow" --hypothesis-profile quick --durations 15

# What waits for the clock leaves most of a core idle, and goes first whenever it has work to do.
test-all: dev  ## all tests but the studies and the browser; those in real time take precedence
	@nice -n 19 $(BIN)/python -m pytest -n $(WORKERS) -m "not realtime" --durations 15 & others=$$!; \
	$(BIN)/python -m pytest -n 0 -m realtime $$(grep -rl --include='test_*.py' mark.realtime tests $(HOCKEY)/tests); \
	realtime=$$?; wait $$others && exit $$realtime

test-browser: dev  ## the pages in a real browser (Chromium of the distribution)
	$(BIN)/python -m pytest -m browser -n 0 tests/report/test_page.py tests/web/test_view.py $(HOCKEY)/tests/web/test_page.py

docs: dev  ## the site, in docs/_build/html, in a minute or two; notebooks without their outputs
	AIRPUCK_DOCS_NOTEBOOKS=off $(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html

notebooks: dev  ## the same with outputs: runs the notebooks whose sources have changed, at first all
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html

dist: dev  ## wheels and sdists, the wheels tried in a fresh environment, and all licences: in dist/
	rm -rf dist build/dist
	$(BIN)/python -m build --outdir dist
	$(BIN)/python -m build --outdir dist $(HOCKEY)
	$(BIN)/python -m venv build/dist
	build/dist/bin/python -m pip install --quiet --disable-pip-version-check dist/*.whl \
		"$$(ls dist/airpuck-*.whl)[$$(echo $(EXTRAS) | tr ' ' ,)]"
	build/dist/bin/python studies/licences.py > dist/LICENCES.md
	build/dist/bin/python -m pip install --quiet --disable-pip-version-check $(TEST_TOOLS)
	$(call test_installed,build/dist)

dist-python: dev  ## try the wheels of dist/ with another Python: PYTHON=python3.13
	rm -rf build/python
	PATH="$$PATH:$(BIN)" uv venv --quiet --python "$(PYTHON)" build/python
	PATH="$$PATH:$(BIN)" uv pip install --quiet --python build/python/bin/python \
		--resolution $(RESOLUTION) -r pyproject.toml $(addprefix --extra ,$(filter-out play,$(EXTRAS))) $(TEST_TOOLS)
	PATH="$$PATH:$(BIN)" uv pip install --quiet --python build/python/bin/python --no-deps dist/*.whl
	$(call test_installed,build/python)

results-quick: dev  ## recompute docs/tables in a minute; which numbers no longer hold?
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
