# Every target sets up what it needs: a virtual environment in .venv, made with any Python from 3.11 to 3.14.
# To choose one: make venv PYTHON=/path/to/python3.13

VENV := .venv
BIN := $(VENV)/bin
PYTHON ?=
CUDA ?=
DEBUG ?=

# An editable install is a path to src/; the core is compiled there by `make core`.
PIP = $(BIN)/python -m pip install --quiet --disable-pip-version-check --config-settings core=later --editable

.PHONY: help venv core demo test versions test-cuda gpu-check sanitize bench bench-gpu bench-cuda bench-window soak lint \
  wheel clean

help:
	@echo "make demo      a small gallery in demo/, to look at"
	@echo "make test      all tests"
	@echo "make versions  a few tests with the lowest and the newest versions of all dependencies"
	@echo "make test-cuda all tests of the CUDA engine at size, on an NVIDIA GPU"
	@echo "make gpu-check tests and benchmarks of CUDA and of drawing on an NVIDIA GPU, in eight minutes"
	@echo "make bench     how fast and how exact, against others"
	@echo "make bench-gpu how fast a GPU draws volumes"
	@echo "make bench-cuda how fast CUDA is on an NVIDIA GPU, against others"
	@echo "make bench-window  how fast the window follows a hand"
	@echo "make soak      slow tests, all combinations of options, and a billion points of random strokes"
	@echo "make sanitize  tests of the native core, with memory and undefined behaviour watched"
	@echo "make lint      style, types and the import rule"
	@echo "make venv      only the virtual environment, in .venv, and the native core"
	@echo "make core      only the native core: what changed is compiled again (DEBUG=1: for a debugger)"
	@echo "make wheel     a wheel for other machines, in dist/"
	@echo "make clean     remove all that these made"

venv: $(VENV)/stamp core

# In place, into src/supple/_core; what did not change is not compiled again.
core: $(VENV)/stamp
	@$(BIN)/python tools/core.py $(if $(filter-out 0,$(DEBUG)),--debug)

$(VENV)/made: pyproject.toml
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
	@touch $@

# What is installed while the core is compiled.
$(VENV)/stamp: pyproject.toml | $(VENV)/made
	@$(BIN)/python tools/install.py dev
	@touch $@

$(VENV)/stamp-bench: $(VENV)/stamp
	$(PIP) '.[bench]'
	@touch $@

# The CUDA engine and the libraries whose arrays it takes, or is compared with. Drivers from 580 on know CUDA 13.
# To choose: make bench-cuda CUDA=12. pip's own PyTorch is for one CUDA only; what PyTorch's site names as the index of
# those for 12 can be given: make bench-cuda CUDA=12 TORCH_INDEX=...
TORCH_INDEX ?=

$(VENV)/stamp-cuda: $(VENV)/stamp
	@cuda="$(CUDA)"; \
	if [ -z "$$cuda" ]; then \
	  driver=$$(nvidia-smi --query-gpu=driver_version --format=csv,noheader 2>/dev/null | head -n 1 | cut -d. -f1); \
	  case "$$driver" in \
	    ''|*[!0-9]*) \
	      echo "make: nvidia-smi finds no driver for an NVIDIA GPU; if there is one, say which CUDA it knows: CUDA=12 or CUDA=13." >&2; \
	      exit 1;; \
	  esac; \
	  if [ "$$driver" -ge 580 ]; then cuda=13; else cuda=12; fi; \
	fi; \
	echo "Adding CUDA $$cuda, PyTorch, CuPy, Numba and kornia to $(VENV): some gigabytes"; \
	pip="$(BIN)/python -m pip install --quiet --disable-pip-version-check"; \
	index="$(if $(TORCH_INDEX),--index-url $(TORCH_INDEX))"; \
	$(PIP) ".[cuda$$cuda]" || exit 1; \
	$$pip $$index torch || echo "make: without PyTorch: its rows say so, and its tests are left out" >&2; \
	for other in "cupy-cuda$${cuda}x[ctk]" "numba-cuda[cu$$cuda]" kornia; do \
	  $$pip "$$other" || echo "make: without $$other: its rows say so, and its tests are left out" >&2; \
	done
	@touch $@

# What was installed since pyproject.toml was last changed.
DONE = $(shell find $(VENV)/stamp $(VENV)/stamp-demo -newer pyproject.toml 2>/dev/null)

# A first look needs neither what tests need, nor a core for other processors.
demo: | $(VENV)/made
	@$(BIN)/python tools/install.py "$(if $(DONE),,demo)" --demo demo
	@touch $(VENV)/stamp-demo

# A worker for each processor. A file's tests stay together, as they share what is made once. Not the files with the most
# tests first: those with the slowest would be last. CUDA is tested on a simulated driver. What needs windows and devices,
# whose memory is freed with its processes alone, is tested before the rest. Bytecode is kept, whatever the environment
# says: hundreds of processes would compile the package anew.
APART := tests/engine tests/cuda tests/gpu tests/torch tests/viewer
TEST := PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -q -n logical --dist loadfile --no-loadscope-reorder

test: venv
	$(TEST) $(APART)
	$(TEST) $(APART:%=--ignore=%)

versions: venv
	$(BIN)/python tools/versions.py

# On a real GPU, one after the other: each test fails where there is none. The last are few, and watched.
test-cuda: venv $(VENV)/stamp-cuda
	SUPPLE_TEST_CUDA=1 $(BIN)/python -m pytest -q tests/cuda
	@if command -v compute-sanitizer >/dev/null; then \
	  SUPPLE_TEST_CUDA=1 compute-sanitizer --tool memcheck --report-api-errors no --error-exitcode 1 \
	    $(BIN)/python -m pytest -q tests/cuda/test_memory.py; \
	else \
	  echo "compute-sanitizer is not on the PATH (it comes with the CUDA toolkit): memory was not checked"; \
	fi

# For a machine that is there for a short time, what it lacks can be carried along: python3 tools/gpu_check.py --help
gpu-check: venv $(VENV)/stamp-cuda
	$(BIN)/python tools/gpu_check.py

# A second build of the core, in build/. To choose tests: make sanitize TESTS=tests/core/test_plans.py
sanitize: $(VENV)/stamp
	@$(BIN)/python tools/core.py --sanitize $(TESTS)

bench: venv $(VENV)/stamp-bench
	$(BIN)/python benchmarks/run.py

bench-gpu: venv
	$(BIN)/python benchmarks/gpu.py

bench-cuda: venv $(VENV)/stamp-cuda
	$(BIN)/python benchmarks/cuda_engine.py

bench-window: venv
	$(BIN)/python benchmarks/window.py

soak: venv
	SUPPLE_TEST_ALL=1 $(TEST) $(APART)
	SUPPLE_TEST_ALL=1 $(TEST) $(APART:%=--ignore=%)
	$(BIN)/python tests/soak.py

lint: $(VENV)/stamp
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	MYPY_NUM_WORKERS=auto $(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/zizmor --offline --no-progress --quiet .github
	$(BIN)/clang-format --dry-run --Werror $(wildcard src/supple/_core/*.[ch]pp src/supple/cuda/kernels/*)

wheel: $(VENV)/stamp
	@$(BIN)/python tools/wheel.py

clean:
	rm -rf $(VENV) build dist demo .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	rm -f src/supple/_core/*.so src/supple/_core/*.pyd src/supple/_core/*.dylib
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
