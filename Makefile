# Two commands matter: `make table` and `make test`. Both make their own virtual environment first.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
JOBS ?= 2
N ?= 5000

.PHONY: table test fuzz lint docs package corpus clean

table: $(VENV)/.installed  ## the failure-rate and timing table over core306
	$(BIN)/fibercontact table --accuracy low --rates mid --jobs $(JOBS) --out runs/core306

test: $(VENV)/.installed  ## the tests
	$(BIN)/python -m pytest -n $(JOBS)

fuzz: $(VENV)/.installed  ## damaged files, N of them: each a problem or an error that names file and fault
	$(BIN)/python tests/fuzz.py $(N)

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(VENV)/.installed  ## the documentation as a site, into build/docs; a warning is an error
	$(BIN)/sphinx-build -W --keep-going -q -d build/doctrees docs build/docs

package: $(VENV)/.installed  ## sdist and wheel, into build/dist, tried out in a new environment
	.ci/package

corpus: $(VENV)/.installed  ## the problems of core306, from the scenes, into build/core306
	$(BIN)/fibercontact corpus build core306 --out build/core306

$(VENV)/.installed: pyproject.toml setup.py fibercontact/__init__.py
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

clean:
	rm -rf build runs .pytest_cache .mypy_cache .ruff_cache .hypothesis
