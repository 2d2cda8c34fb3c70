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

clean:
	rm -rf .venv out
