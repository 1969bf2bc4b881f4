# Every target creates what it needs: a virtual environment `.venv` in the checkout with the package in it.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
EXTRAS := fast,rerun,parquet,campaign,test,lint
# Tests in virtual time: two processes may share them. All others talk in real time, one after the other.
VIRTUAL := calibration campaign controller docs estimator kinematics plant plugin procedure procedures report trajectories
CLIMB := out/demo/recording_x_line_ekf_seed_1

.PHONY: help demo demo-calibration docs test test-long lint bench clean

help:
	@echo "make demo       the robot climbs an emulated wall: report, recording, Rerun file, replay"
	@echo "make demo-calibration  calibrate on a generated data set and name the pages"
	@echo "make test       run the default test suite"
	@echo "make test-long  run the tests that take minutes, too"
	@echo "make lint       ruff, mypy --strict, import-linter"
	@echo "make docs       write docs/bench-file.md afresh"
	@echo "make bench      print the measured ratios"

$(BIN)/.installed: pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "CPython 3.10 to 3.13 is needed: set PYTHON=/path/to/python3"; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[$(EXTRAS)]"
	$(BIN)/hil info --compile
	@touch $@

demo: $(BIN)/.installed
	rm -rf out/demo
	$(BIN)/hil run wall_tracking --seed 1 --out out/demo
	$(BIN)/hil replay $(CLIMB).mcap --verify
	$(BIN)/hil replay $(CLIMB).mcap --page out/demo/replay.html --rerun $(CLIMB).rrd
	@echo "report:           out/demo/report.html   (estimators on the same recording: out/demo/replay.html)"
	@echo "recording:        $(CLIMB).mcap"
	@echo "look at it:       $(BIN)/rerun $(CLIMB).rrd"

demo-calibration: $(BIN)/.installed
	$(BIN)/hil demo-data out/demo-calibration/data --corrupt circle_cw_2
	$(BIN)/hil evaluate out/demo-calibration/data
	$(BIN)/hil calibrate out/demo-calibration/data --out out/demo-calibration/calibration.toml --plots out/demo-calibration/fit
	$(BIN)/hil evaluate out/demo-calibration/data --calibration out/demo-calibration/calibration.toml --plots out/demo-calibration/after
	@echo "calibration file: out/demo-calibration/calibration.toml"
	@echo "open out/demo-calibration/fit/index.html and out/demo-calibration/after/index.html"

test: $(BIN)/.installed
	@failed=0; \
	$(BIN)/python -m pytest -n 2 --dist loadfile $(VIRTUAL:%=tests/%) || failed=1; \
	$(BIN)/python -m pytest $(VIRTUAL:%=--ignore=tests/%) || failed=1; \
	exit $$failed

test-long: $(BIN)/.installed
	$(BIN)/python -m pytest -m "long or not long" --timeout 3600

lint: $(BIN)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(BIN)/.installed
	@failed=0; \
	for script in benchmarks/*.py; do echo "== $$script"; $(BIN)/python $$script || failed=1; done; \
	exit $$failed

docs: $(BIN)/.installed
	$(BIN)/python docs/make_bench_reference.py

clean:
	rm -rf $(VENV) out build *.egg-info
