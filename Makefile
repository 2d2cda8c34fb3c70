# `make demo` runs the main job, `make test` all checks; both make their own environment in .venv.
PYTHON ?= python3
LINKS := $(or $(UV_FIND_LINKS),$(PIP_FIND_LINKS),$(shell $(PYTHON) -m pip config get global.find-links 2>/dev/null))
UV := VIRTUAL_ENV=$(CURDIR)/.venv .venv/bin/uv
REAL := $(or $(NINEDTACT_REAL_DATA),../shared/real)

.PHONY: demo test lint types benchmarks clean

.venv/ready: pyproject.toml constraints.txt
	test -x .venv/bin/uv || { $(PYTHON) -m venv .venv && .venv/bin/python -m pip install -q uv; }
	$(UV) pip install -q $(if $(LINKS),--find-links $(LINKS)) -c constraints.txt -e '.[studio,train,dev]'
	touch $@

test: .venv/ready lint types
	.venv/bin/python -m pytest -n 2

lint: .venv/ready
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .

types: .venv/ready
	.venv/bin/mypy

# The main job on real pictures: one sensor calibrated, one press reconstructed. Left in out/demo.
demo: .venv/ready
	@test -d $(REAL)/sensor_a || { echo "expected real pictures in $(REAL), got none; set NINEDTACT_REAL_DATA to a folder of them"; exit 1; }
	.venv/bin/ninedtact calibrate --out out/demo/sensor_a \
	  --board-reference $(REAL)/sensor_a/board_reference.png --board $(REAL)/sensor_a/board.png \
	  --ball-reference $(REAL)/sensor_a/ball_reference.png --ball $(REAL)/sensor_a/ball.png
	.venv/bin/ninedtact reconstruct --sensor out/demo/sensor_a \
	  --reference $(REAL)/sensor_a/ball_reference.png $(REAL)/sensor_a/ball.png --out out/demo/ball

# Measured figures beside their peers; docs/figures.md holds the last ones. One alone: make benchmarks/board_accuracy
BENCHMARKS := start_up board_accuracy ball_accuracy frame_speed board_robustness memory
.PHONY: $(addprefix benchmarks/,$(BENCHMARKS))

benchmarks: $(addprefix benchmarks/,$(BENCHMARKS))

$(addprefix benchmarks/,$(BENCHMARKS)): .venv/ready
	.venv/bin/python $@.py

clean:
	rm -rf .venv out
