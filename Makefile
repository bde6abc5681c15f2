# Everything from a bare machine with Python >= 3.11: each target makes its own environment first.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
EXPERIMENT ?= C
SEED ?= 0
OUT ?= runs/$(EXPERIMENT)-equivariant-seed$(SEED)

.PHONY: discover test lint docs figures-docs benchmark results seeds optima pretrained compare clean

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "murmurate needs Python >= 3.11; set PYTHON=...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $@

discover: $(VENV)/.installed  ## train (or go on), evaluate and draw one experiment (EXPERIMENT=C SEED=0 OUT=runs/...)
	$(BIN)/murmurate discover $(EXPERIMENT) --seed $(SEED) --out $(OUT) --resume

test: lint  ## style, types, layers and all tests
	$(BIN)/pytest -n 2

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright

docs: $(VENV)/.installed  ## the documentation site, warnings are errors; into build/docs
	$(BIN)/sphinx-build -W --keep-going -n -q -b html docs build/docs

figures-docs: $(VENV)/.installed  ## draws the figures of docs/world.md again
	$(BIN)/python docs/draw.py

benchmark: $(VENV)/.installed  ## speed, limits and memory beside other projects (minutes); writes docs/benchmarks.md
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[benchmark]'
	$(BIN)/python -m benchmarks --out docs/benchmarks.md --json docs/benchmarks.json --figure docs/figures/cost.png

results: $(VENV)/.installed  ## trains A-F with both policies and three seeds (hours); writes docs/results.md
	$(BIN)/python -m benchmarks.results

seeds: $(VENV)/.installed  ## trains sixteen seeds of A-F (an hour or two); writes docs/discoveries.md
	$(BIN)/python -m benchmarks.seeds

optima: $(VENV)/.installed  ## searches for better patterns than the best known (two hours); keeps what is better
	$(BIN)/python -m benchmarks.optima

pretrained: $(VENV)/.installed  ## trains the weights that come with the package (two hours on one core)
	$(BIN)/python -m benchmarks.pretrained

compare: $(VENV)/.installed  ## learned policies and baselines, 1,000 starts a cell (hours); writes into docs/results.md and point.md
	$(BIN)/python -m benchmarks.compare

clean:
	rm -rf $(VENV) build *.egg-info
