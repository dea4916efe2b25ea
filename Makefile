# SPDX-License-Identifier: MIT
# Targets that need the environment create it; it is made again when pyproject.toml or constraints.txt change.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := build/demo
READY := $(VENV)/.ready
BENCH_READY := $(VENV)/.bench-ready
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable

UNCOMPILED := $(patsubst %, tests/unit/%.py, model/test_block_index formats/container/test_checksum \
	decoder/test_decoder encoder/packetizer/test_packetizer metrics/test_quality model/test_decoded_model \
	encoder/fusion/test_ray_update stream/notes/test_frame_report encoder/segmentation/test_segmentation \
	synthesis/test_shapes encoder/fusion/test_model_entropy)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help install demo test test-long lint typecheck contracts coverage golden fuzz bench bench-ci bench-ci-baseline \
	bench-rd bench-tasks paper docs build clean check

help: ## Show the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' Makefile | expand -t 12

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "3dvc needs Python 3.11 or newer; run: make PYTHON=/path/to/python3.11 ...")'
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) '.[dev,plot]'
	touch $@

$(BENCH_READY): $(READY)
	$(INSTALL) '.[bench]'
	touch $@

install: $(READY) ## Create .venv and install the checkout with its tools

demo: $(READY) ## Make a small sequence, encode it, decode it, print the report
	rm -rf $(DEMO)
	mkdir -p $(DEMO)
	$(BIN)/3dvc synth $(DEMO)/room --scene room --frames 60 --size 320x240 --noise kinect
	$(BIN)/3dvc encode $(DEMO)/room $(DEMO)/room.3dvc --voxel-size 16mm --color-video off
	$(BIN)/3dvc decode $(DEMO)/room.3dvc $(DEMO)/decoded
	$(BIN)/python benchmarks/montage.py $(DEMO)/room $(DEMO)/decoded $(DEMO)/montage.png
	$(BIN)/3dvc stats $(DEMO)/room.3dvc --reference $(DEMO)/room
	@echo
	@echo "Stream:           $(DEMO)/room.3dvc"
	@echo "Decoded pictures: $(DEMO)/decoded/color and $(DEMO)/decoded/depth"
	@echo "Side by side:     $(DEMO)/montage.png"

test: $(READY) ## Run the tests, on all processors
	$(BIN)/python -m pytest --quiet --numprocesses auto -m 'not long'

test-long: $(READY) ## Run what make test leaves out: recorded sequences, soaks
	$(BIN)/python -m pytest --quiet --numprocesses auto -m long

lint: $(READY) ## Check style and format (ruff)
	$(BIN)/ruff check
	$(BIN)/ruff format --check

typecheck: $(READY) ## Check types (mypy, strict)
	$(BIN)/mypy

contracts: $(READY) ## Check the direction of imports (import-linter)
	$(BIN)/lint-imports

coverage: $(READY) ## Report line and branch coverage; kernels count where tests can run them uncompiled
	$(BIN)/python -m pytest --quiet --numprocesses auto -m 'not long' --cov --cov-report=
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest --quiet --cov --cov-append --cov-report=term --cov-report=html \
		-W 'ignore:overflow encountered:RuntimeWarning' $(UNCOMPILED)

golden: $(READY) ## Write the golden streams anew; every release must still decode the earlier ones
	$(BIN)/python tests/golden/make_golden.py

fuzz: $(READY) ## Feed damaged streams to the reader for longer than the tests do
	THREEDVC_EXAMPLES=5000 $(BIN)/python -m pytest --quiet tests/fuzz tests/property

bench-ci: $(READY) ## Guard speed and size against benchmarks/ci_baseline.json
	$(BIN)/python benchmarks/ci.py

bench-ci-baseline: $(READY) ## Renew that baseline; commit it with the reason
	$(BIN)/python benchmarks/ci.py --renew

bench: $(READY) ## Measure speed, memory, quality and tracking, write tables in benchmarks
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/sequences.py
	$(BIN)/python benchmarks/tracking.py

bench-rd: $(BENCH_READY) ## Compare with other codecs over the range of quality, write RESULTS.md and plots in benchmarks
	$(BIN)/python benchmarks/rd.py

bench-tasks: $(BENCH_READY) ## Measure what decoded frames are good for, write TASKS.md in benchmarks
	$(BIN)/python benchmarks/tasks.py

paper: $(READY) ## Repeat the experiment of the 1995 paper
	$(BIN)/python benchmarks/paper_experiment.py build/paper

docs: $(READY) ## Write docs/cli.md from the commands' own help
	$(BIN)/python docs/make_cli.py

build: $(READY) ## Build the source archive and the wheel into dist/
	rm -rf dist build/lib build/bdist.*
	$(BIN)/python -m build --outdir dist

check: lint typecheck contracts test ## Everything a change must pass

clean: ## Remove what the targets made
	rm -rf $(VENV) build dist htmlcov *.egg-info .coverage .hypothesis .mypy_cache .pytest_cache .ruff_cache .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
