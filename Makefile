# Every target sets up what it needs: a virtual environment in .venv, made with any Python from 3.11 to 3.14.
# To choose one: make venv PYTHON=/path/to/python3.13

VENV := .venv
BIN := $(VENV)/bin
PYTHON ?=

.PHONY: help venv demo test bench bench-gpu bench-window soak lint clean

help:
	@echo "make demo      a small gallery in demo/, to look at"
	@echo "make test      all tests"
	@echo "make bench     how fast and how exact, against others"
	@echo "make bench-gpu how fast the GPU is, in its own time"
	@echo "make bench-window  how fast the window follows a hand"
	@echo "make soak      ten million points of random strokes"
	@echo "make lint      style, types and the import rule"
	@echo "make venv      only the virtual environment, in .venv"
	@echo "make clean     remove all that these made"

venv: $(VENV)/stamp

$(VENV)/stamp: pyproject.toml
	@if $(BIN)/python -m pip --version >/dev/null 2>&1; then exit 0; fi; \
	found=; bare=; \
	for python in $(if $(PYTHON),"$(PYTHON)",python3.14 python3.13 python3.12 python3.11 python3 python); do \
	  "$$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' 2>/dev/null || continue; \
	  if "$$python" -c 'import ensurepip, venv' 2>/dev/null; then found=$$python; break; fi; \
	  bare=$$python; \
	done; \
	if [ -z "$$found" ] && [ -n "$$bare" ]; then \
	  echo "make: $$bare cannot make virtual environments: its venv or ensurepip module is missing." >&2; \
	  echo "make: on Debian and Ubuntu: apt install python3-venv; then run make again." >&2; \
	  exit 1; \
	elif [ -z "$$found" ]; then \
	  echo "make: no Python from 3.11 to 3.14 found$(if $(PYTHON), at $(PYTHON))." >&2; \
	  echo "make: install one, or name yours: make venv PYTHON=/path/to/python3" >&2; \
	  exit 1; \
	fi; \
	echo "Setting up $(VENV) with $$found"; \
	"$$found" -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

$(VENV)/stamp-bench: $(VENV)/stamp
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	@touch $@

demo: venv
	$(BIN)/supple demo demo --force

# A worker for each core; a file's tests stay together, so that a kernel is compiled by few of them. What CUDA does is
# tested on a card that Numba plays.
test: venv
	$(BIN)/python -m pytest -q -n auto --dist loadfile
	NUMBA_ENABLE_CUDASIM=1 $(BIN)/python -m pytest -q -n auto tests/cuda

bench: venv $(VENV)/stamp-bench
	$(BIN)/python benchmarks/run.py

bench-gpu: venv
	$(BIN)/python benchmarks/gpu.py

bench-window: venv
	$(BIN)/python benchmarks/window.py

soak: venv
	$(BIN)/python tests/soak.py

lint: venv
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

clean:
	rm -rf $(VENV) build dist demo .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
