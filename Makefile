# Everything from a machine with git, make and Python 3.11 to 3.13: `make demo`, `make test`.
# Set-up runs once by itself, and again when pyproject.toml changes.

VENV  := .venv
PY    := $(VENV)/bin/python
READY := $(VENV)/.ready
STEPS := not slow and not hardware and not realtime
PYTEST := $(PY) -m pytest -q -rs
# One process more than processors, up to 4 for the memory: some tests wait for doubles at real pace while others compute.
# Each has one thread: else their libraries share no core.
WORKERS := $(shell n=$$(getconf _NPROCESSORS_ONLN 2>/dev/null || echo 2); echo $$(( n < 3 ? n + 1 : 4 )))
PARALLEL := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(PYTEST) -n $(WORKERS) --dist worksteal

# The first interpreter that fits; PYTHON=... names another.
PYTHONS := $(PYTHON) python3 python3.13 python3.12 python3.11
FITS    := import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))

export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PYTHONUNBUFFERED := 1
# Tests start some 200 processes: each would compile the package anew.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup system-libraries demo samples bench bench-suite test unit test-slow test-cores test-realtime docs gallery pictures lint format clean

help:
	@printf '%-20s%s\n' 'make demo' 'measure what is built in, and leave the recording (125 MB) in runs/'
	@printf '%-20s%s\n' 'make test' 'lints, types and tests (minutes)'
	@printf '%-20s%s\n' 'make test-slow' 'the tests that take many minutes as well'
	@printf '%-20s%s\n' 'make test-realtime' 'the tests that watch the host'"'"'s clock (on an idle machine)'
	@printf '%-20s%s\n' 'make test-cores' 'the numerical tests with two kinds of kernels of the BLAS (minutes)'
	@printf '%-20s%s\n' 'make bench' 'what MSM costs on this machine, as a table'
	@printf '%-20s%s\n' 'make bench-suite' 'the same for comparing commits, with pytest-benchmark'
	@printf '%-20s%s\n' 'make samples' 'make the small recordings in recordings/ anew'
	@printf '%-20s%s\n' 'make docs' 'the site, in build/site'
	@printf '%-20s%s\n' 'make gallery' 'pictures and films of every view, in build/gallery (needs Vulkan)'
	@printf '%-20s%s\n' 'make pictures' 'the pictures of docs and README of today (needs Vulkan and Chromium)'
	@printf '%-20s%s\n' 'make lint' 'lints and types alone'
	@printf '%-20s%s\n' 'make format' 'write the house format'
	@printf '%-20s%s\n' 'make setup' 'the virtual environment alone (the others do this by themselves)'
	@printf '%-20s%s\n' 'make clean' 'remove what was built; recordings in runs/ stay'

setup: $(READY)
	@:

$(READY): pyproject.toml
	@if [ ! -x $(PY) ] || ! $(PY) -c '$(FITS)' 2>/dev/null || ! $(PY) -m pip --version >/dev/null 2>&1; then \
		found=; \
		for python in $(PYTHONS); do \
			if command -v $$python >/dev/null 2>&1 && $$python -c '$(FITS)' 2>/dev/null; then found=$$python; break; fi; \
		done; \
		if [ -z "$$found" ]; then \
			echo 'setup: no Python 3.11, 3.12 or 3.13 here; install one, or name it: make PYTHON=/path/to/python3.11' >&2; exit 1; \
		fi; \
		if ! $$found -c 'import venv, ensurepip' 2>/dev/null; then \
			echo "setup: $$found has no venv; install it, for example: sudo apt-get install -y python3-venv" >&2; exit 1; \
		fi; \
		echo "setup: making $(VENV) with $$($$found --version)"; \
		$$found -m venv --clear $(VENV) || exit 1; \
	fi
	@if [ -f .ci/system-libraries ]; then sh .ci/system-libraries; fi
	@echo 'setup: pip installs the packages into $(VENV): the first time some minutes, and 3 GB'
	@$(PY) -m pip install -qq --no-compile --editable '.[dev]' || \
		{ echo 'setup: pip could not install the packages; its reason stands above (no network?)' >&2; exit 1; }
	@touch $@
	@echo 'setup: ready'

system-libraries:
	@sh .ci/system-libraries

demo: setup
	@$(PY) -m deformscope demo

samples: setup
	@$(PY) tools/sample_recordings.py

# Types are checked by one processor, while the others begin with the tests.
test: setup
	@$(MAKE) --no-print-directory -j 2 lint unit

unit: setup
	@$(PY) -m compileall -q deformscope drivers studies
	$(PARALLEL) -m '$(STEPS)'

# What a processor needs for the kernels that OpenBLAS has for a core type.
CORES := Haswell:avx2 SkylakeX:avx512f

test-cores: setup
	@for core in $(CORES); do \
		if grep -qw "$${core#*:}" /proc/cpuinfo; then \
			echo "OPENBLAS_CORETYPE=$${core%:*}"; \
			OPENBLAS_CORETYPE=$${core%:*} $(PARALLEL) -m '$(STEPS)' tests/stages || exit 1; \
		else \
			echo "OPENBLAS_CORETYPE=$${core%:*}: skipped, the processor has no $${core#*:}"; \
		fi; \
	done

test-slow: setup
	$(PARALLEL) -m 'not hardware and not realtime'

# One at a time, on a machine with nothing else to do: they watch the host's clock.
test-realtime: setup
	$(PYTEST) -m 'realtime and not hardware'

docs: setup
	@NO_MKDOCS_2_WARNING=1 DISABLE_MKDOCS_2_WARNING=true $(PY) -m mkdocs build --quiet
	@echo 'read it: $(PY) -m http.server --bind 127.0.0.1 --directory build/site, at http://127.0.0.1:8000'

gallery: setup
	@$(PY) tools/gallery.py

pictures: setup
	@$(PY) tools/pictures.py

bench: setup
	@$(PY) -m deformscope bench

bench-suite: setup
	$(PYTEST) -p benchmark -m bench tests/bench

# `python tools/words.py docs --long` lists the sentences of a page or folder that are too long.
lint: setup
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m codespell_lib .
	$(PY) tools/words.py
	$(PY) -m mypy

format: setup
	$(PY) -m ruff check --fix .
	$(PY) -m ruff format .

clean:
	rm -rf $(VENV) dist build .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find deformscope drivers studies tests -name __pycache__ -type d -prune -exec rm -rf {} +
