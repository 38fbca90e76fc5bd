# Everything happens in a virtual environment of the checkout's own. PYTHON chooses the interpreter.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt

# Bytecode is kept, whatever the environment says: without it each process of each call compiles all tests anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test test-all lint docs gallery bench fuzz crash clean

help:
	@echo "make demo    set up, and match the two shapes that ship with the project"
	@echo "make test    set up, and run the quick tests (5 minutes on two cores)"
	@echo "make test-all  run those and the long ones: processes, pages, browser (some 18 minutes)"
	@echo "make lint    set up, and run the linter and the type checker; prints the code's shape"
	@echo "make docs    set up, and build the site into build/site"
	@echo "make gallery make the pictures of the site anew (some 5 minutes; needs Chromium)"
	@echo "make bench   set up, and time every step in yardsticks (about 20 minutes)"
	@echo "make crash   set up, kill commands 100 times, and compare their ends (about 20 minutes)"
	@echo "make fuzz    set up, and read 20,000 damaged files with every reader (some 15 minutes; Linux)"
	@echo "make clean   remove the virtual environment and caches"

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	@echo "Installing homolog into $(VENV); the first time this takes some minutes."
	$(INSTALL) --editable .
	@touch $@

$(VENV)/installed-dev: $(VENV)/installed
	@echo "Installing what the tests need."
	$(INSTALL) --editable '.[dev]'
	@touch $@

demo: $(VENV)/installed
	$(BIN)/homolog demo

# A process per core. The files of the quick tests stay together, as their tests share what they made; the others are
# few and long, and go to whichever process is free.
test: $(VENV)/installed-dev
	$(BIN)/python -m pytest -n auto --dist loadfile -m "not long"

test-all: test
	$(BIN)/python -m pytest -n auto --dist worksteal -m long --durations 20

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	@$(BIN)/python tools/code_shape.py

# The theme's word on what will follow it is no warning of this site.
docs: $(VENV)/installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "Open build/site/index.html."

gallery: $(VENV)/installed-dev
	$(BIN)/python tools/make_gallery.py docs/gallery.md docs/tutorials/collections.md

bench: $(VENV)/installed-dev
	$(BIN)/python benchmarks/bench.py

# A folder that is there already is not written into.
crash: $(VENV)/installed-dev
	$(BIN)/python tools/crash.py build/crash --kills 100

# Failures are printed, and their files kept in build/fuzz/failures. SEED chooses other mutants.
SEED ?= 1
fuzz: $(VENV)/installed-dev
	$(BIN)/python tools/fuzz.py --mutants 20000 --seed $(SEED) --out build/fuzz

clean:
	rm -rf $(VENV) build .pytest_cache .hypothesis .mypy_cache .ruff_cache
