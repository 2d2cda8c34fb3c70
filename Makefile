# `make demo` shows what this is, `make test` runs all checks. Both create their own environment in .venv; the demo installs only
# what it needs.
PYTHON ?= python3
LINKS := $(or $(UV_FIND_LINKS),$(PIP_FIND_LINKS),$(shell $(PYTHON) -m pip config get global.find-links 2>/dev/null))
UV := VIRTUAL_ENV=$(CURDIR)/.venv .venv/bin/uv
INSTALL := $(UV) pip install -q $(if $(LINKS),--find-links $(LINKS)) -c constraints.txt
REAL := $(or $(NINEDTACT_REAL_DATA),../shared/real)

# Tests and benchmarks start commands hundreds of times; these shall load compiled modules, as they do for a user.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo real test test-core test-lowest test-pythons test-cluster test-interop chaos soak damaged mutants lock licences lint types coverage docs docs-images gallery tour dist benchmarks clean

.venv/bin/uv:
	$(PYTHON) -m venv .venv
	.venv/bin/python -m pip install -q uv

PROJECTS := pyproject.toml $(wildcard packages/*/pyproject.toml) constraints.txt
CORE := packages/ninedtact
.venv/ready-demo: $(PROJECTS) | .venv/bin/uv
	$(INSTALL) -e '$(CORE)[studio]'
	touch $@

.venv/ready: $(PROJECTS) | .venv/bin/uv
	$(INSTALL) -e '$(CORE)[studio]' -e 'packages/ninedtact-train[training]' -e packages/ninedtact-hardware --group dev
	touch $@ .venv/ready-demo

.venv/ready-cluster: .venv/ready
	$(INSTALL) -e '$(CORE)[cluster]'
	touch $@

.venv/ready-interop: .venv/ready
	$(INSTALL) -e '$(CORE)[ros2,stream,foxglove,rerun]' -e 'packages/ninedtact-train[reinforcement]'
	touch $@

.venv/ready-docs: .venv/ready
	$(INSTALL) --group docs
	touch $@

# Three workers keep two cores busy, because many tests wait for a browser, a camera or another process. The tests of a file run on
# one worker, so that what they share is made once; conftest.py says which files begin. One of them is
# tests/test_types.py, which does what `make types` does.
PYTEST := .venv/bin/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder
test: .venv/ready lint
	$(PYTEST)

# The first distribution alone.
test-core: .venv/ready lint
	$(PYTEST) $(CORE)/tests

# What a person does at the command line, with the lowest versions that pyproject.toml declares, and with newer interpreters. Each
# runs in an environment of its own, without torch.
JOURNEYS := $(CORE)/tests/test_journeys.py $(CORE)/tests/test_force_journeys.py $(CORE)/tests/cli
JOURNEY_INSTALL = VIRTUAL_ENV=$(CURDIR)/.venv-$* .venv/bin/uv pip install -q $(if $(LINKS),--find-links $(LINKS)) -c constraints.txt \
	-e '$(CORE)[studio,force,recording]' -e packages/ninedtact-train 'cloudpickle>=3' 'filelock>=3.12' 'pytest>=8' 'hypothesis>=6.100' 'trimesh>=4'
RUN_JOURNEYS = JAXTYPING_DISABLE=1 .venv-$*/bin/python -m pytest $(JOURNEYS)

test-lowest: test-with-lowest

test-with-%: .venv/bin/uv
	.venv/bin/uv venv -q --clear --python $(PYTHON) .venv-$*
	$(JOURNEY_INSTALL) --resolution $*-direct
	$(RUN_JOURNEYS)

test-pythons: test-python-3.12 test-python-3.13

# An interpreter that is missing is passed over with a line that says so.
test-python-%: .venv/bin/uv
	@python=$$(.venv/bin/uv python find --no-project --no-python-downloads $* 2>/dev/null \
	  || ls $${PYENV_ROOT:-$$HOME/.pyenv}/versions/$*.*/bin/python 2>/dev/null | tail -1); \
	if test -z "$$python"; then echo "Python $*: PASSED OVER, no interpreter found here; 'uv python install $*' installs one"; exit; fi; \
	set -ex; .venv/bin/uv venv -q --clear --python $$python .venv-$*; $(JOURNEY_INSTALL); $(RUN_JOURNEYS)

# The versions of all packages for development, which `pip install -r requirements-dev.lock` installs anywhere.
lock: .venv/bin/uv
	.venv/bin/uv pip compile -q --upgrade $(wildcard packages/*/pyproject.toml) --group dev --python-version 3.11 --extra studio --extra training \
	  -c constraints.txt $(if $(LINKS),--find-links $(LINKS)) --no-emit-index-url --no-emit-find-links $(addprefix --no-emit-package ,ninedtact ninedtact-train ninedtact-hardware) \
	  --custom-compile-command "make lock" -o requirements-dev.lock
	sed -i -E 's/^([a-z0-9._-]+==[^+ ]+)\+[a-z0-9.]+/\1/' requirements-dev.lock  # +cpu names a build that lies on some machines only

# The licences of all libraries that the package may load at run time; fails where one demands that programs using it take its licence.
licences: .venv/ready
	.venv/bin/python scripts/list_licences.py

# Work on a local Dask cluster, which is started and ended here. Types are checked by `make test`.
test-cluster: .venv/ready-cluster
	JAXTYPING_DISABLE=1 .venv/bin/python -m pytest -m cluster packages/ninedtact-train/tests/test_clusters.py

# Doors to other programs, tried against those programs (MuJoCo, DDS, Foxglove, Rerun, C++, JavaScript; LeRobot in an environment
# of its own). What needs none of them runs in `make test`.
test-interop: .venv/ready-interop .venv-lerobot/ready
	.venv/bin/python -m pytest -m 'interop or not interop' $(CORE)/tests/interop packages/ninedtact-train/tests/environments \
	  tests/test_examples.py::test_a_policy_learns_to_insert_a_peg
	HF_HUB_OFFLINE=1 .venv-lerobot/bin/python -m pytest $(LEROBOT_PLUGIN)/tests

# LeRobot in an environment of its own, because it pins other versions. It allows no torch as new as that of the checks.
LEROBOT_PLUGIN := plugins/lerobot_camera_ninedtact
.venv-lerobot/ready: $(PROJECTS) $(LEROBOT_PLUGIN)/pyproject.toml $(LEROBOT_PLUGIN)/tests/overrides.txt | .venv/bin/uv
	.venv/bin/uv venv -q --clear --python $(PYTHON) .venv-lerobot
	VIRTUAL_ENV=$(CURDIR)/.venv-lerobot .venv/bin/uv pip install -q $(if $(LINKS),--find-links $(LINKS)) \
	  --override $(LEROBOT_PLUGIN)/tests/overrides.txt -e '$(CORE)[recording]' -e $(LEROBOT_PLUGIN) 'pytest>=8' 'mcap-ros2-support>=0.5'
	touch $@

# Commands that are interrupted, killed or out of disk, and hours of use in half an hour: docs/reliability.md holds the tables.
chaos: .venv/ready
	.venv/bin/python benchmarks/chaos.py

soak: .venv/ready
	.venv/bin/python benchmarks/soak.py

# Damaged and edited files of every kind, and files of strangers, a hundred cases each: about two hours.
damaged: .venv/ready
	NINEDTACT_DAMAGED_CASES=$(or $(CASES),100) JAXTYPING_DISABLE=1 .venv/bin/python -m pytest tests/test_damaged_files.py tests/test_files_of_strangers.py

# Do the tests notice a changed operator? [tool.mutmut] of the core's pyproject.toml says which files are changed; MUTANTS chooses some
# of them by name. `mutmut results` and `mutmut show NAME` in that folder show the survivors.
mutants: .venv/ready
	$(UV) pip install -q mutmut
	cd $(CORE) && JAXTYPING_DISABLE=1 $(CURDIR)/.venv/bin/mutmut run $(MUTANTS)

lint: .venv/ready
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .

types: .venv/ready
	.venv/bin/mypy

# Line coverage of the whole test suite; each line that no test runs is marked in out/coverage/index.html.
coverage: .venv/ready
	$(PYTEST) --cov=ninedtact --cov=ninedtact_train --cov=ninedtact_hardware --cov-report=html:out/coverage

# The documentation site, in out/site, which works without a network. Warnings, broken links and files from elsewhere are errors.
docs: .venv/ready-docs
	.venv/bin/python scripts/draw_architecture.py
	.venv/bin/python scripts/write_command_reference.py
	.venv/bin/mkdocs build --strict --site-dir out/site
	.venv/bin/python scripts/check_site.py out/site

# The pictures of docs/gallery.md but that of the live page (`make docs-images`), and the notebook with its page, run again; one to two
# minutes each. The pictures of a real sensor are drawn where its images are available.
gallery: .venv/ready
	.venv/bin/python scripts/draw_gallery.py $(if $(wildcard $(REAL)/sensor_a/ball.png),--real $(REAL)/sensor_a)

tour: .venv/ready
	.venv/bin/python scripts/run_tour.py

# The distributions for PyPI, in dist: built, checked, and tried in a fresh environment that holds nothing else.
TOOL := .venv/bin/uv tool run -q $(if $(LINKS),--find-links $(LINKS))
dist: .venv/bin/uv
	rm -rf dist out/dist_check && mkdir -p out/dist_check
	for one in packages/*; do .venv/bin/uv build -q $(if $(LINKS),--find-links $(LINKS)) --out-dir dist $$one || exit; done
	.venv/bin/uv build -q $(if $(LINKS),--find-links $(LINKS)) --out-dir dist plugins/lerobot_camera_ninedtact
	$(TOOL) twine check --strict dist/*.whl dist/*.tar.gz
	$(TOOL) check-wheel-contents dist
	.venv/bin/python scripts/check_distributions.py dist
	.venv/bin/uv venv -q --clear --python $(PYTHON) .venv-dist
	VIRTUAL_ENV=$(CURDIR)/.venv-dist .venv/bin/uv pip install -q $(if $(LINKS),--find-links $(LINKS)) -c constraints.txt \
	  "$$(ls dist/ninedtact-*.whl)[studio]"
	cd out/dist_check && ../../.venv-dist/bin/ninedtact --version && ../../.venv-dist/bin/ninedtact demo --rounds 1 --port 0

# The pictures of the page in docs/images, taken in a browser without a window: about five minutes.
docs-images: .venv/ready
	@if test -f $(REAL)/sensor_a/ball.png; \
	then $(CALIBRATE_A) && .venv/bin/python scripts/draw_page_images.py --sensor out/demo/sensor_a; \
	else .venv/bin/python scripts/draw_page_images.py; fi

# A simulated sensor in the browser: calibrated, pressed, dragged and twisted. At a terminal Ctrl-C ends it, without one it
# ends by itself. Results are in out/demo. Where real images are available, it is the twin of the sensor that took them.
demo: .venv/ready-demo
	@if test -f $(REAL)/sensor_a/ball.png; \
	then $(CALIBRATE_A) && .venv/bin/ninedtact demo --out out/demo --sensor out/demo/sensor_a; \
	else .venv/bin/ninedtact demo --out out/demo; fi

# Calibrates a real sensor from its images and reconstructs one press. Results are in out/real.
real: .venv/ready-demo
	@test -d $(REAL)/sensor_a || { echo "expected real images in $(REAL), got none; set NINEDTACT_REAL_DATA to a folder of them"; exit 1; }
	$(subst out/demo,out/real,$(CALIBRATE_A))
	.venv/bin/ninedtact reconstruct --sensor out/real/sensor_a \
	  --reference $(REAL)/sensor_a/ball_reference.png $(REAL)/sensor_a/ball.png --out out/real/ball

CALIBRATE_A = .venv/bin/ninedtact calibrate --out out/demo/sensor_a \
	--board-reference $(REAL)/sensor_a/board_reference.png --board $(REAL)/sensor_a/board.png \
	--ball-reference $(REAL)/sensor_a/ball_reference.png --ball $(REAL)/sensor_a/ball.png

# Measured figures beside those of their peers; docs/figures.md holds the latest. One alone: make benchmarks/board_accuracy
SHARED_BY_BENCHMARKS := ball_in_layer figures live_page neo_hookean original real_images real_sensor_twins turns
BENCHMARKS := $(filter-out $(SHARED_BY_BENCHMARKS) chaos soak,$(basename $(notdir $(wildcard benchmarks/*.py))))
.PHONY: $(addprefix benchmarks/,$(BENCHMARKS))

benchmarks: $(addprefix benchmarks/,$(BENCHMARKS))

benchmarks/mujoco_speed: .venv/ready-interop

$(addprefix benchmarks/,$(BENCHMARKS)): .venv/ready
	.venv/bin/python $@.py

clean:
	rm -rf .venv .venv-* out
