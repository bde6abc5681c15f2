# Everything from a bare machine with Python >= 3.11: each target makes its own environment first.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
EXPERIMENT ?= C
SEED ?= 0
# With constraints-oldest.txt, give another VENV too: what is installed already stays.
CONSTRAINTS ?= constraints.txt
# By default runs/EXPERIMENT-LEARNER-seedSEED.
OUT ?=

.PHONY: discover test pytest test-nightly lint dist docs figures-docs benchmark results problems formations seeds archives optima pretrained models compare clean

# Compiling every module takes as long as unpacking them. A run imports one in ten, which Python compiles and keeps.
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --constraint $(CONSTRAINTS) --editable
unexport PYTHONDONTWRITEBYTECODE
# Tests import much more, in many processes. Some modules are for other versions of Python.
COMPILE := { $(BIN)/python -m compileall -q -j 0 $(VENV) >/dev/null 2>&1 || true; }

# An environment that was made by hand has no stamp, and needs no installation where it has the packages.
has = [ ! -e $@ ] && $(BIN)/python -c 'import sys; [*map(__import__, sys.argv[1:])]' $(1) 2>/dev/null

# What training, evaluation and figures need; then what tests, checks and documentation need besides.
$(VENV)/.core: pyproject.toml $(CONSTRAINTS)
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "murmurate needs Python >= 3.11; set PYTHON=...")'
	$(call has,murmurate) || { $(PYTHON) -m venv $(VENV) && $(INSTALL) .; }
	touch $@

$(VENV)/.dev: $(VENV)/.core
	$(call has,murmurate pytest sphinx) || { $(INSTALL) '.[dev]' && $(COMPILE); }
	touch $@

# Exit status 5: the run is finished, with fewer valid patterns than asked for, which it says itself.
discover: $(VENV)/.core  ## train (or go on), evaluate and draw one experiment (EXPERIMENT=C SEED=0 OUT=runs/...)
	$(BIN)/murmurate discover $(EXPERIMENT) --seed $(SEED) $(if $(OUT),--out $(OUT)) --resume || [ $$? -eq 5 ]

test: lint pytest  ## style, types, layers and the tests (8 minutes on two cores)

pytest: $(VENV)/.dev  ## the tests alone
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder

test-nightly: lint  ## the long tests besides: Ray, Slurm, several hosts, large swarms, 100,000 configurations
	MURMURATE_TEST_COMPILER=full $(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder -m 'nightly or not nightly'

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff check --preview --select PLW1514 .  # every text file has an encoding
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright

dist: $(VENV)/.dev  ## wheel and sdist into dist/, and the wheel tried outside of the checkout
	rm -rf dist build/wheel
	$(BIN)/python -m build --outdir dist
	$(PYTHON) -m venv build/wheel
	$(subst $(VENV),build/wheel,$(BIN))/python -m pip install --quiet --disable-pip-version-check --constraint $(CONSTRAINTS) dist/*.whl
	cd build && $(subst $(VENV),wheel,$(BIN))/python ../tests/try_installed.py

docs: $(VENV)/.dev  ## the documentation site, warnings are errors; into build/docs
	$(BIN)/sphinx-build -W --keep-going -n -q -b html docs build/docs

figures-docs: $(VENV)/.dev  ## draws the figures of docs/world.md again
	$(BIN)/python docs/draw.py

benchmark: $(VENV)/.dev  ## speed, limits and memory beside other projects (minutes); writes docs/benchmarks.md
	$(BIN)/python -c 'import jaxmarl' 2>/dev/null || $(INSTALL) '.[benchmark]'
	$(BIN)/python -m benchmarks --out docs/benchmarks.md --json docs/benchmarks.json --figure docs/figures/cost.png

results: $(VENV)/.core  ## trains A-F with each learner and five seeds (hours); writes docs/results.md
	$(BIN)/python -m benchmarks.results

problems: $(VENV)/.core  ## trains the problems of the package for 4 to 10 robots (an hour); writes docs/problems.md
	$(BIN)/python -m benchmarks.problems

formations: $(VENV)/.core  ## other patterns than the best, and random ones (an hour); writes docs/formations.md
	$(BIN)/python -m benchmarks.formations

seeds: $(VENV)/.core  ## searches formations of A-F with sixteen seeds (an hour); writes docs/discoveries.md
	$(BIN)/python -m benchmarks.seeds

archives: $(VENV)/.core  ## searches, annealing and MAP-Elites (pyribs) at equal cost (an hour); writes into docs/formations.md
	$(BIN)/python -c 'import ribs' 2>/dev/null || $(INSTALL) '.[benchmark]'
	$(BIN)/python -m benchmarks.archives

optima: $(VENV)/.core  ## searches for better patterns than the best known (two hours); keeps what is better
	$(BIN)/python -m benchmarks.optima

pretrained: $(VENV)/.core  ## trains the weights that come with the package (two hours on two cores)
	$(BIN)/python -m benchmarks.pretrained

models: $(VENV)/.core  ## the package's weights from every set of starts (hours); writes the tables of docs/models.md
	$(BIN)/python -m benchmarks.models

compare: $(VENV)/.core  ## learned policies and baselines, 1,000 starts a cell (hours); writes into docs/results.md and point.md
	$(BIN)/python -m benchmarks.compare

clean:
	rm -rf $(VENV) .cache build dist *.egg-info
