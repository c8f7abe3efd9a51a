# make demo     a first render, into demo-output/
# make test     the tests, on every OpenCL device of the machine, on all cores; ARGS='-k haar -x -n 0' goes to pytest
# make lint     ruff and mypy
# make clean    remove what these made, except the virtual environment; make distclean removes that as well
#
# Each does all of its own set-up: on a fresh machine only Python >= 3.10 (with venv) and a C linker must be there.
# Another Python: make PYTHON=python3.12 test

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

demo: linker $(VENV)/.installed-demo
	$(BIN)/prtcl demo -o demo-output

test: linker $(VENV)/.installed-test
	PRTCL_REQUIRE_DEVICE=1 $(BIN)/python -m pytest -n auto --dist worksteal $(ARGS)

lint: $(VENV)/.installed-lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# What each needs beside prtcl itself.
$(VENV)/.installed-demo: EXTRAS := pocl
$(VENV)/.installed-test: EXTRAS := pocl,test
$(VENV)/.installed-lint: EXTRAS := lint

# Editable for all three: a copy that the demo installed would otherwise be what the tests run.
$(VENV)/.installed-%: setup.cfg pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[$(EXTRAS)]'
	@$(BIN)/prtcl devices >/dev/null 2>&1 || $(MAKE) --no-print-directory intel
	@touch $@

# PoCL's wheel dates from 2022: on a younger CPU it lists a device and cannot compile for it.
intel:
	@echo "no usable OpenCL device yet: adding Intel's CPU runtime (about 300 MB to fetch)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[intel]'
	@$(BIN)/prtcl devices

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	    { echo '$(PYTHON) is not a Python >= 3.10: name one with make PYTHON=...' >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) || \
	    { rm -rf $(VENV); echo '$(PYTHON) cannot make a virtual environment: apt install python3-venv' >&2; exit 1; }

# PoCL, the OpenCL for the CPU, links each kernel it builds, and aborts the process where it cannot.
linker:
	@command -v cc >/dev/null && command -v ld >/dev/null && \
	    case "$$(uname -s) $$(cc -print-file-name=crti.o)" in 'Linux crti.o') false ;; esac || \
	    { echo 'PoCL needs a C linker, cc and ld and the C library to link with: apt install gcc libc6-dev' >&2; exit 1; }

clean:
	rm -rf demo-output build dist prtcl.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find prtcl tests bench examples -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true
	rm -f $(VENV)/.installed-*

distclean: clean
	rm -rf $(VENV) .venv-intel

.PHONY: demo test lint linker intel clean distclean
