.DEFAULT_GOAL := help
PYTHON ?= python3
PIP_ARGS ?=
VENV := .venv
RUN := $(VENV)/bin/python
READY := $(VENV)/.installed
PIP = $(RUN) -m pip install --disable-pip-version-check --progress-bar off -c constraints.txt $(PIP_ARGS)
BRIAN2 := build/brian2
LARGE_DOWNLOADS := sed -un -e 's/^ *Downloading \(.* [0-9.]* [MG]B)\).*/  \1/p' -e 's/^Installing collected.*/  unpacking/p'

.PHONY: help install table figures report search bench bench-descriptors bench-maps gpu-check nir-check test test-all chaos check docs clean

help: ## Say what can be made.
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 20

install: $(READY) ## Make .venv and install the pinned packages (PIP_ARGS passes options to pip).

# NORDLAND and ROBOTCAR are folders of real frames; DATASETS, METHODS and STORES are lists with commas.
comma_list = $(if $($(1)),"$(2)=[$($(1))]")
ASKED = $(if $(NORDLAND),"nordland=$(NORDLAND)") $(if $(ROBOTCAR),"robotcar=$(ROBOTCAR)") \
	$(call comma_list,DATASETS,columns) $(call comma_list,METHODS,methods) $(call comma_list,STORES,stores) \
	$(if $(SEEDS),seeds=$(SEEDS)) $(if $(filter 1 true yes,$(FULL)),full=true) $(ARGS)

table: $(READY) ## Table II, measured beside published: NORDLAND= ROBOTCAR= DATASETS= METHODS= SEEDS= STORES= FULL=1 ARGS=
	$(RUN) -m vprbench table $(ASKED)

figures: $(READY) ## The figures of the paper and more, as PDF and PNG in results/figures (the same options).
	$(RUN) -m vprbench table figures=true $(ASKED)

report: $(READY) ## One HTML page with table, figures and a browser of failures (the same options).
	$(RUN) -m vprbench table page=true $(ASKED)

search: $(READY) ## Search VPRTempo's hyperparameters on places that no result uses: PLACES= TRIALS= JOBS= ARGS=
	$(RUN) -m vprbench search $(if $(PLACES),places=$(PLACES)) $(if $(TRIALS),trials=$(TRIALS)) \
		$(if $(JOBS),workers=$(JOBS)) $(ARGS)

# Speed at full size, on pytest-benchmark; ARGS are options of pytest, such as -k queries or --benchmark-compare.
BENCH = OPENBLAS_THREAD_TIMEOUT=16 BENCH=full $(RUN) -m pytest --benchmark-enable --benchmark-only --timeout 0 -q -s
OTHER_BENCHMARKS = $(addprefix --ignore tests/benchmarks/,test_descriptors.py test_maps.py)

bench: $(READY) ## Measure how fast this machine trains and answers, write results/bench.md and .json: ARGS="-k queries"
	$(BENCH) tests/benchmarks $(OTHER_BENCHMARKS) --benchmark-json results/bench.json $(ARGS)
	$(RUN) tests/benchmarks/report.py results/bench.json results/bench.md

bench-descriptors: $(READY) ## Measure how fast methods describe frames, no weights needed, write results/descriptors.md: ARGS="-k sad"
	$(BENCH) tests/benchmarks/test_descriptors.py --benchmark-json results/descriptors.json $(ARGS)
	$(RUN) tests/benchmarks/report.py results/descriptors.json results/descriptors.md

bench-maps: $(READY) ## Measure what large maps cost by each index, write results/maps.md: MAPS=1000000x512,100000x64 ARGS="-k binary"
	$(if $(MAPS),MAPS=$(MAPS)) $(BENCH) tests/benchmarks/test_maps.py --benchmark-json results/maps.json $(ARGS)
	$(RUN) tests/benchmarks/report.py results/maps.json results/maps.md

gpu-check: $(READY) ## On a machine with a GPU: compare it with the CPU, time both, write results/gpu.md: ARGS="-k queries"
	$(BENCH) tests/gpu --benchmark-json results/gpu.json $(ARGS)
	$(RUN) tests/benchmarks/report.py results/gpu.json results/gpu.md

nir-check: $(READY) $(BRIAN2)/.installed ## Ask networks that are stored as NIR in snnTorch and in Brian2, count equal best places: QUERIES=
	$(RUN) tests/oracles/nir_check.py $(BRIAN2)/bin/python $(QUERIES)

# A worker for each core, one thread each; a worker that is done takes tests from the others.
PYTEST = OMP_NUM_THREADS=1 $(RUN) -m pytest --numprocesses auto --dist worksteal

test: $(READY) ## Run all tests but the extended ones; nothing beside the checkout is needed (ARGS passes options).
	$(PYTEST) -m "not extended" $(ARGS)

test-all: $(VENV)/.triton $(BRIAN2)/.installed ## Run the extended tests too: real frames, Chromium, LaTeX, Brian2, Triton, networks at full size.
	$(PYTEST) $(ARGS)

chaos: $(READY) ## Kill workers, scheduler and client of a sweep for ten minutes, and see that nothing is lost: MINUTES= SEED=
	$(RUN) tests/chaos/chaos.py $(if $(MINUTES),--minutes $(MINUTES)) $(if $(SEED),--seed $(SEED)) $(ARGS)

check: $(READY) ## Lint, formatting and types.
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports --no-logo

docs: $(VENV)/.docs ## Build the documentation site in build/docs; a broken link is an error.
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --strict
	@echo "build/docs/index.html"

clean: ## Remove everything that can be made again; stored runs under results/ stay.
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(READY): pyproject.toml constraints.txt
	@echo "installing the pinned packages into $(VENV): some minutes, mostly downloads"
	@$(RUN) -c "import ssl" 2>/dev/null || $(PYTHON) -m venv --clear $(VENV)
	$(PIP) -e ".[dev]" | $(LARGE_DOWNLOADS)
	@$(RUN) -m pip show --quiet vprbench
	@touch $@

# Brian2 2.9 asks NumPy for a method that is no more in 2.4: it has a Python of its own.
$(BRIAN2)/.installed:
	$(PYTHON) -m venv $(BRIAN2)
	$(BRIAN2)/bin/python -m pip install --quiet --disable-pip-version-check $(PIP_ARGS) \
		brian2==2.9.0 "numpy<2.4" nir==1.0.8 h5py==3.16.0
	@touch $@

# Triton's interpreter runs the GPU training where no GPU is; PyTorch's CUDA builds bring their own.
$(VENV)/.triton: $(READY)
	$(RUN) -c "import triton" 2>/dev/null || $(PIP) --quiet triton==3.9.0
	@touch $@

$(VENV)/.docs: $(READY)
	$(PIP) -e ".[docs]" | $(LARGE_DOWNLOADS)
	@$(RUN) -m pip show --quiet mkdocs-material
	@touch $@
