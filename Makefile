# One verb per wish. Everything is installed into .venv, nothing outside this folder.
#
#   make install   install clothtrack; make EXTRAS=realsense install: with this extra
#   make learn     install what learning and the network need too (the extra learn)
#   make demo      install, track the shipped recording, name the report
#   make test      install the test tools too, run the tests
#   make pages     open every page in a headless Chromium, where there is one
#   make proofs    every experiment in its small form, learning, runs that are killed
#   make mutations break the source in some 90 places; the tests must notice each
#   make wheel     build a wheel, run the demo from it away from this folder
#   make release   build what is released twice, compare, try it on every Python; bill of materials
#   make check     lint, format, types, direction of imports, size (budget.toml)
#   make docs      the documentation as a site with the demo's page, to out/site
#   make bench     quick forms of all benchmarks, to out/bench_*.json (docs/speed.md)
#
# PYTHON=python3.12 make demo    chooses the interpreter (3.11 or newer)

PYTHON ?= $(firstword $(foreach name,python3.11 python3.12 python3.13 python3,$(shell command -v $(name) 2>/dev/null)))
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
EXTRAS ?=
PYTEST_ARGS ?= -n auto --maxprocesses 4 --dist loadfile

# The operations are small: a second thread per process waits more than it works.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Half the start of a test worker is compiling what was compiled in the last run.
unexport PYTHONDONTWRITEBYTECODE

# What `make test` leaves out because it takes long: experiments, learning, runs that are killed.
PROOFS := tests/experiments tests/reconstruction tests/planning tests/tracking \
  tests/world/test_bench.py tests/world/test_one_garment.py \
  tests/end_to_end/test_interruption.py tests/end_to_end/test_many_processes.py \
  tests/end_to_end/test_corrected_recordings.py tests/end_to_end/test_cropped_recording.py \
  tests/files/test_ray_tasks.py tests/files/test_worker_pool.py \
  tests/cli/test_command_line.py tests/cli/test_on_a_terminal.py tests/cli/test_look.py \
  tests/examples/test_notebooks.py \
  tests/published_networks tests/verification/test_cuda_compiles.py

.DEFAULT_GOAL := help
.PHONY: help install learn demo test test-all pages proofs mutations wheel release check docs format bench clean

help:
	@sed -n '3,17s/^# \{0,1\}//p' Makefile

install: $(VENV)/.installed $(EXTRAS:%=$(VENV)/.installed-%)

learn: $(VENV)/.installed-learn

$(VENV)/.created:
	@test -n "$(PYTHON)" || { echo "no python3 found; install Python 3.11 or newer" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "$(PYTHON) is too old; clothtrack needs Python 3.11 or newer: make PYTHON=python3.12" >&2; exit 1; }
	@rm -rf $(VENV)
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "$(PYTHON) cannot make a virtual environment; on Debian or Ubuntu: apt install python3-venv" >&2; exit 1; }
	@touch $@

$(VENV)/.installed: $(VENV)/.created pyproject.toml constraints.txt
	@echo "installing clothtrack into $(VENV) ..."
	@$(PIP) --editable .
	@touch $@

$(VENV)/.installed-%: $(VENV)/.installed
	@echo "installing the extra $* into $(VENV) ..."
	@$(PIP) --editable '.[$*]'
	@touch $@

demo: $(VENV)/.installed
	$(BIN)/clothtrack demo --output out/demo

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest $(PYTEST_ARGS)

test-all: $(VENV)/.installed-dev
	$(BIN)/python -m pytest $(PYTEST_ARGS) -m "not gpu and not data"

pages: $(VENV)/.installed-dev
	$(BIN)/python -m pytest $(PYTEST_ARGS) -rs -m "slow and not gpu and not data" \
	  tests/report tests/capture tests/house_rules

proofs: $(VENV)/.installed-dev
	$(BIN)/python -m pytest $(PYTEST_ARGS) -m "slow and not gpu and not data" $(PROOFS)

mutations: $(VENV)/.installed-dev
	$(BIN)/python tests/mutations/run.py

wheel: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow tests/end_to_end/test_wheel.py

release:
	.ci/release $(PYTHONS)

check: $(VENV)/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/lint-imports --no-cache
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/python tests/house_rules/budget.py

docs: $(VENV)/.installed-dev
	$(BIN)/python docs/make_api.py
	$(BIN)/clothtrack demo --output out/demo >/dev/null
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	cp out/demo/fold_the_tshirt.html out/site/demo.html

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

bench: $(VENV)/.installed-bench
	@mkdir -p out
	for name in solver alignment tracking calibration import scaling live; do \
	  $(BIN)/python benchmarks/bench_$$name.py --quick --json out/bench_$$name.json || exit 1; \
	done

clean:
	rm -rf $(VENV) out .pytest_cache .ruff_cache
