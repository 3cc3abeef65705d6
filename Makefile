# A thin face of the command line `truing`: it prepares the environment and passes on what is asked for.
#
#   make all                        every stage that is not up to date, on the sample campaign
#   make all CAMPAIGN=my-campaign   the same on another one
#   make pose CAMPAIGN=my-campaign  one stage by its name, and what it needs
#   make quick | test               fast tests of the algorithms in a minute; all tests
#   make check | bench              style, types and collection; side by side with other libraries
#   make docs | links               the pages as a site in build/docs/html; do their outside links still lead somewhere
#   make setup | lock | clean       the environment alone; locked versions anew; all but the runs removed

CAMPAIGN ?= sample_data/telescope
PYTHON ?= python3
VENV ?= .venv
export CAMPAIGN

python := $(VENV)/bin/python
digest = $(shell { pwd; cat pyproject.toml setup.py requirements/$(1).txt; } | cksum | tr ' ' -)
runtime := $(VENV)/ready-runtime-$(call digest,runtime)
version := $(shell sed -n 's/^__version__ = "\(.*\)"$$/\1/p' truing/__init__.py)
dev := $(VENV)/ready-dev-$(call digest,dev)

.PHONY: all setup quick test check bench docs links lock clean

all: $(runtime)
	@$(VENV)/bin/truing run "$$CAMPAIGN"

setup: $(runtime)
	@:

# Workers share the cores; libraries that start threads of their own would only queue for them. Large arrays, which come
# and go, keep their pages (glibc; elsewhere unheeded).
quick test: export OMP_NUM_THREADS = 1
quick test: export MALLOC_MMAP_THRESHOLD_ = 1000000000
quick test: export MALLOC_TRIM_THRESHOLD_ = 2000000000
test: $(dev)
	$(python) -m pytest -n auto --dist worksteal

# One example of each law, and one run of all stages (the fixture `workplace`, which tests/runs uses).
laws := $(addprefix tests/,calibration estimation inference runs schemas simulation)
quick: $(dev)
	$(python) -m pytest -n auto --dist worksteal -m "not slow" --hypothesis-profile quick $(laws)

check: $(dev)
	$(python) -m ruff check .
	@rm -rf build/types && mkdir -p build/types/truing
	@ln -s $(abspath $(wildcard truing/*) schemas stages pipeline) build/types/truing/
	$(python) -m mypy
	$(python) -m pytest -qq --collect-only
	$(python) -m pytest -q tests/packaging

bench: $(dev)
	$(python) -m benchmarks

docs: $(dev)
	$(python) -m sphinx --quiet --fail-on-warning --keep-going docs build/docs/html/$(version)
	@echo "open build/docs/html/index.html"

links: $(dev)
	$(python) -m sphinx --quiet --builder linkcheck docs build/docs/links

# Any other target is the name of a stage; the command line knows them, and answers where there is none.
.DEFAULT:
	@$(MAKE) --no-print-directory setup
	@$(VENV)/bin/truing run --only $@ "$$CAMPAIGN"

# pip compiles every module, the tests of others too, on one core: `compile` leaves those out and uses all cores.
# A module left out is compiled at its first import, or, under PYTHONDONTWRITEBYTECODE, at each.
install := $(python) -m pip install --quiet --no-compile --only-binary :all: --require-hashes
compile = $(python) -m compileall -q -j 0 -x '/(tests|testing|validators|_vendor)/' \
	$$($(python) -c 'import sysconfig; print(sysconfig.get_path("purelib"))') truing schemas stages pipeline

# An environment is ready when its mark is there, and the mark carries a digest of all that the environment
# was made from. `unfinished` stays behind where an installation was cut short: then it is made afresh.
$(runtime):
	@$(PYTHON) -c 'import sys; sys.exit("truing needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	@if [ -e $(VENV)/unfinished ]; then rm -rf $(VENV); fi
	@mkdir -p $(VENV) && touch $(VENV)/unfinished
	@if [ ! -x $(python) ]; then $(PYTHON) -m venv $(VENV); fi
	$(install) -r requirements/runtime.txt
	$(python) -m pip install --quiet --no-deps --no-build-isolation -e .
	$(compile)
	@rm -f $(VENV)/ready-* $(VENV)/unfinished && touch $@

$(dev): $(runtime)
	@touch $(VENV)/unfinished
	$(install) -r requirements/dev.txt
	@rm -f $(VENV)/unfinished && touch $@

lock := uv pip compile pyproject.toml --universal --python-version 3.11 --fork-strategy fewest \
	--generate-hashes --no-emit-index-url --no-header --no-annotate --quiet
lock:
	$(lock) --extra build -o requirements/runtime.txt
	$(lock) --extra build --extra dev -c requirements/runtime.txt -o requirements/dev.txt

clean:
	rm -rf $(VENV) build dist *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
