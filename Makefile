# Every target sets up what it needs in .venv; Python 3.11 or newer and make are all that must be there.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
INSTALLED := .venv/.installed
BENCH_INSTALLED := .venv/.installed-bench

.PHONY: help demo test test-slow lint bench

help:
	@echo 'make demo       fit clouds to example photographs and write a page with the results to demo/'
	@echo 'make test       the tests, in minutes'
	@echo 'make test-slow  the tests that take long'
	@echo 'make lint       style, types and layers'
	@echo 'make bench NAME=question [ARGS=--quick]   one benchmark'

demo: $(INSTALLED)
	$(BIN)/cloudfit demo --out demo

test: $(INSTALLED)
	$(BIN)/python -m pytest -n 2

test-slow: $(INSTALLED)
	$(BIN)/python -m pytest -m slow

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(BENCH_INSTALLED)
	$(BIN)/python -m benchmarks $(NAME) $(ARGS)

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[fast,shafts,test]'
	touch $@

$(BENCH_INSTALLED): $(INSTALLED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[fast,shafts,test,bench]'
	touch $@
