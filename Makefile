# Every target creates what it needs: a virtual environment `.venv` in the checkout with the package in it.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
EXTRAS := fast,rerun,parquet,test,lint

.PHONY: help demo test test-long lint bench clean

help:
	@echo "make demo       calibrate on a generated data set and name the pages"
	@echo "make test       run the default test suite"
	@echo "make test-long  run the tests that take minutes, too"
	@echo "make lint       ruff, mypy --strict, import-linter"
	@echo "make bench      print the measured ratios"

$(BIN)/.installed: pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "CPython 3.10 to 3.13 is needed: set PYTHON=/path/to/python3"; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[$(EXTRAS)]"
	@touch $@

demo: $(BIN)/.installed
	$(BIN)/hil demo-data out/demo/data --corrupt circle_cw_2
	$(BIN)/hil evaluate out/demo/data
	$(BIN)/hil calibrate out/demo/data --out out/demo/calibration.toml --plots out/demo/calibration
	$(BIN)/hil evaluate out/demo/data --calibration out/demo/calibration.toml --plots out/demo/evaluation
	@echo "calibration file: out/demo/calibration.toml"
	@echo "open out/demo/calibration/index.html and out/demo/evaluation/index.html"

test: $(BIN)/.installed
	$(BIN)/python -m pytest

test-long: $(BIN)/.installed
	$(BIN)/python -m pytest -m "long or not long" --timeout 3600

lint: $(BIN)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(BIN)/.installed
	@for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done

clean:
	rm -rf $(VENV) out build *.egg-info
