.DEFAULT_GOAL := help
PYTHON ?= python3
PIP_ARGS ?=
VENV := .venv
RUN := $(VENV)/bin/python
READY := $(VENV)/.installed

.PHONY: help install table bench bench-descriptors gpu-check test test-triton check clean

help: ## Say what can be made.
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 20

install: $(READY) ## Make .venv and install the pinned packages (PIP_ARGS passes options to pip).

table: $(READY) ## Run SAD and VPRTempo on the embedded journey and write results/table.md and .csv (ARGS passes options).
	$(RUN) -m vprbench table $(ARGS)

bench: $(READY) ## Measure how fast this machine trains and answers, write results/bench.md and .json (ARGS passes options).
	$(RUN) -m vprbench bench $(ARGS)

bench-descriptors: $(READY) ## Measure how fast descriptors are, no weights needed, write results/descriptors.md (ARGS passes options).
	$(RUN) -m vprbench bench-descriptors $(ARGS)

gpu-check: $(READY) ## On a machine with a GPU: compare it with the CPU, time it, write results/gpu.md (ARGS passes options).
	$(RUN) -m vprbench gpu-check $(ARGS)

test: $(READY) ## Run all tests, a worker with one thread for each core (ARGS passes options).
	OMP_NUM_THREADS=1 $(RUN) -m pytest --numprocesses auto --dist loadfile $(ARGS)

test-triton: $(READY) ## Run the tests of the GPU training in Triton's interpreter, without a GPU; installs triton (280 MB).
	$(RUN) -c "import triton" 2>/dev/null || $(RUN) -m pip install --quiet --disable-pip-version-check $(PIP_ARGS) triton==3.9.0
	VPRBENCH_INSIST_ON_TRITON=1 $(RUN) -m pytest tests/test_vprtempo_fused_cuda.py $(ARGS)

check: $(READY) ## Lint, formatting and types.
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

clean: ## Remove everything that can be made again; stored runs under results/ stay.
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --disable-pip-version-check -c constraints.txt $(PIP_ARGS) -e ".[dev]"
	@touch $@
