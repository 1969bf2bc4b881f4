# Every target creates what it needs: a virtual environment `.venv` in the checkout with the package in it, and the
# packages of its extras, in the version and with the hash that LOCK names. `make LOCK= test` takes the newest
# versions that pyproject.toml allows instead, in `.venv-newest`; `make OLDEST=1 test` the oldest, in `.venv-oldest`.
PYTHON ?= python3
OLDEST :=
RERUN := 1
LOCK := $(if $(OLDEST),,requirements/ci.lock)
VENV := $(if $(OLDEST),.venv-oldest,$(if $(LOCK),.venv,.venv-newest))
BIN := $(VENV)/bin
PIP = $(BIN)/python -m pip install --quiet --disable-pip-version-check
UV = $(BIN)/uv pip install --quiet --python $(BIN)/python
PINS := $(if $(OLDEST),--resolution lowest-direct,$(if $(LOCK),--only-binary :all: -c $(LOCK)))
EXTRAS := rerun parquet campaign mujoco paper ros2 gamepad test lint docs
FOR_demo := $(if $(RERUN),rerun)
FOR_test := $(filter-out lint docs,$(EXTRAS))
FOR_lint := $(filter-out docs,$(EXTRAS))
FOR_docs := $(filter-out lint,$(EXTRAS))
RECORDED := out/recorded
CLIMB := out/demo/recording_x_line_ekf_seed_1

SCHEMA = $(BIN)/check-jsonschema --quiet --builtin-schema

.PHONY: help demo demo-calibration record verify docs site dist notebooks pictures test test-slowest test-long test-portable test-aarch64 lint lock bench clean

help:
	@echo "make demo       the robot climbs an emulated wall: report, recording, Rerun file, replay (RERUN=: without, half the size)"
	@echo "make demo-calibration  calibrate on a generated data set and name the pages"
	@echo "make test       run the default test suite"
	@echo "make test-slowest  run it and list the twenty slowest tests"
	@echo "make test-long  run the tests that take minutes, too"
	@echo "make test-portable  run what depends on numbers as other processors would compute (SHORT=1: a part)"
	@echo "make test-aarch64  the bench on an emulated aarch64 computer (Debian on x86-64; takes half an hour)"
	@echo "make record     record a short drive in $(RECORDED), for another computer"
	@echo "make verify     verify what another computer has recorded and left in $(RECORDED)"
	@echo "make lint       ruff, mypy --strict, import-linter, schemas of the workflows"
	@echo "make docs       write the references in docs/ and the pictures of rooms and robot afresh"
	@echo "make site       build the documentation site in out/site, every warning an error"
	@echo "make notebooks  run both notebooks of docs/notebooks"
	@echo "make dist       build wheel and source archive in dist/ and check them"
	@echo "make pictures   the Rerun view and the console as pictures, without a screen (Vulkan driver, Chromium)"
	@echo "make bench      one table of speed, ours beside a peer, and how cost grows"
	@echo "make lock       write $(LOCK) afresh, with the newest versions"

$(BIN)/uv: $(LOCK)
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 14))' || \
	{ echo "CPython 3.10 to 3.14 is needed: set PYTHON=/path/to/python3"; exit 2; }
	@test -z "$(LOCK)" || case $$(uname -sm) in "Linux x86_64" | "Linux aarch64") ;; \
	*) echo "$(LOCK) is for Linux on x86_64 and aarch64: try make LOCK="; exit 2;; esac
	$(PYTHON) -m venv $(VENV)
ifeq ($(LOCK),)
	$(PIP) uv
else
	sed -n '/^uv==/,/^ *#/p' $(LOCK) > $(VENV)/uv.txt
	$(PIP) --require-hashes --no-deps --only-binary :all: -r $(VENV)/uv.txt
endif
	@touch $@

# The packages of FOR_demo, FOR_test, FOR_lint or FOR_docs; what others have installed stays.
$(BIN)/.for-%: $(BIN)/uv pyproject.toml requirements/build.in $(LOCK)
	$(UV) $(PINS) -r requirements/build.in
	$(UV) $(PINS) $(if $(LOCK),--require-hashes) -r pyproject.toml $(FOR_$*:%=--extra %)
	$(UV) --no-deps --no-build-isolation -e .
	$(if $(filter demo test,$*),$(BIN)/hil info --compile)
	@touch $@

demo: $(BIN)/.for-demo
	rm -rf out/demo
	$(BIN)/hil run wall_tracking --seed 1 --out out/demo --set 'feedbacks=["odometry", "ekf"]' \
	--set optimal=false --set processes=2 --set bench.emulation.adhesion.start=tethered \
	--set bench.emulation.thrust.start=tethered
	@$(BIN)/hil replay $(CLIMB).mcap --verify & verified=$$!; \
	$(BIN)/hil replay $(CLIMB).mcap --page out/demo/replay.html $(if $(RERUN),--rerun $(CLIMB).rrd); shown=$$?; \
	wait $$verified && exit $$shown
	@echo "report:           out/demo/report.html   (estimators on the same recording: out/demo/replay.html)"
	@echo "recording:        $(CLIMB).mcap"
	@$(if $(RERUN),echo "look at it:       $(BIN)/rerun $(CLIMB).rrd",:)

demo-calibration: $(BIN)/.for-demo
	rm -rf out/demo-calibration
	$(BIN)/hil demo-data out/demo-calibration/data --corrupt circle_cw_2
	$(BIN)/hil evaluate out/demo-calibration/data
	$(BIN)/hil calibrate out/demo-calibration/data --out out/demo-calibration/calibration.toml --plots out/demo-calibration/fit
	$(BIN)/hil evaluate out/demo-calibration/data --calibration out/demo-calibration/calibration.toml --plots out/demo-calibration/after
	@echo "calibration file: out/demo-calibration/calibration.toml"
	@echo "open out/demo-calibration/fit/index.html and out/demo-calibration/after/index.html"

# Hundreds of tests start a process: compiled code is kept for it, also where the environment asks for none.
test test-slowest: export PYTHONDONTWRITEBYTECODE :=
test: $(BIN)/.for-test
	@$(BIN)/python tests/in_two_lanes.py

test-slowest: $(BIN)/.for-test
	@failed=0; $(BIN)/python tests/in_two_lanes.py out/durations || failed=1; \
	$(BIN)/python tests/slowest.py out/durations; exit $$failed

test-long: $(BIN)/.for-docs
	$(BIN)/python -m pytest -m "long or not long" --hypothesis-profile thorough --timeout 3600

test-portable: export PYTHONDONTWRITEBYTECODE :=
test-portable: $(BIN)/.for-test
	@$(BIN)/python tests/portable.py $(if $(SHORT),--short)

test-aarch64: $(BIN)/.for-test
	$(BIN)/python tests/on_aarch64.py

record: $(BIN)/.for-demo
	rm -rf $(RECORDED)
	$(BIN)/hil run wall_tracking --seed 1 --out $(RECORDED) --set 'cases=["x_line"]' \
	--set 'feedbacks=["ekf", "ukf"]' --set optimal=false --set length_m=0.3 --set duration_s=6

verify: $(BIN)/.for-demo
	@test -n "$(wildcard $(RECORDED)/*.mcap)" || { echo "$(RECORDED) holds no recording: make record"; exit 2; }
	for recording in $(RECORDED)/*.mcap; do $(BIN)/hil replay $$recording --verify || exit 1; done

lint: $(BIN)/.for-lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(SCHEMA) vendor.github-workflows .github/workflows/*.yml docs/ci-template/.github/workflows/*.yml
	$(SCHEMA) custom.github-workflows-require-timeout .github/workflows/*.yml
	$(SCHEMA) vendor.github-actions .github/actions/*/action.yml
	$(SCHEMA) vendor.gitlab-ci --data-transform gitlab-ci docs/ci-template/.gitlab-ci.yml
	$(SCHEMA) vendor.github-issue-forms .github/ISSUE_TEMPLATE/*.yml

bench: $(BIN)/.for-test
	$(BIN)/python benchmarks/table.py

docs: $(BIN)/.for-lint
	$(BIN)/python docs/make_bench_reference.py
	$(BIN)/python docs/make_fault_reference.py
	$(BIN)/python docs/make_python_reference.py
	$(BIN)/python docs/make_command_reference.py
	$(BIN)/python docs/make_architecture.py
	$(BIN)/python docs/images/render_robot_on_wall.py

site: $(BIN)/.for-docs
	@echo "reads every page and docstring, then writes the site: two to four minutes"
	$(BIN)/python -m sphinx -q -W --keep-going -b html -c docs . out/site
	@echo "open out/site/index.html"

notebooks: $(BIN)/.for-docs
	$(BIN)/python -m pytest -q -m long tests/docs/test_notebooks.py

dist: $(BIN)/.for-docs
	rm -rf build dist
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation -w dist .
	$(BIN)/python -c 'from setuptools.build_meta import build_sdist; print(build_sdist("dist"))'
	$(BIN)/python -m twine check --strict dist/*

pictures: $(BIN)/.for-test
	$(BIN)/python docs/images/render_rerun_view.py
	$(BIN)/python docs/images/render_console.py

lock: $(BIN)/uv
	$(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.10 --only-binary :all: \
	--generate-hashes \
	--custom-compile-command "make lock" $(EXTRAS:%=--extra %) \
	pyproject.toml requirements/build.in -o $(LOCK)

clean:
	rm -rf .venv .venv-newest .venv-oldest out build dist *.egg-info
