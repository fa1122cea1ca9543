# Every target sets up what it needs in .venv; Python >= 3.11 and make are all that must be there.
# Another interpreter: make PYTHON=/path/to/python3.12 test (after rm -rf .venv, if there is one already).
PYTHON ?= python3.13 python3.12 python3.11 python3

VENV := .venv
BIN := $(VENV)/bin
STAMPS := $(VENV)/.stamps
TEST_ARGS ?=
WORKERS ?= 2
KERNELS ?= Haswell Sandybridge
RUN_ARGS ?=

export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_NO_INPUT := 1
export MPLBACKEND := Agg

.DEFAULT_GOAL := help
STUDIES := structure single calibration faults noise further unlisted names shapes
.PHONY: help demo test test-kernels lint format docs docs-site package gallery bench bench-arms study-systems $(STUDIES:%=study-%) table1 table2 figures \
  reproduce-smoke clean
# Two pips must not write to one environment at a time.
.NOTPARALLEL:

help:
	@echo "make demo           find the Lagrangian of a measured double pendulum; report in demo-output/"
	@echo "make test           run the tests (TEST_ARGS='-k spline' for some of them, WORKERS=8 on eight cores)"
	@echo "make test-kernels   run the numeric tests under other kernels of OpenBLAS (KERNELS='$(KERNELS)')"
	@echo "make lint           check style, types and the direction of imports"
	@echo "make format         put the code into the style that lint checks"
	@echo "make docs           build the documentation into docs/_build/html, gallery included (minutes)"
	@echo "make docs-site      the same into site/VERSION, with a menu of all versions that lie in site/"
	@echo "make package        build wheel and source distribution into dist/, and check and try them"
	@echo "make gallery        run every script of examples/ as a test"
	@echo "make bench          measure speed"
	@echo "make bench-arms     simulated arms and peers (RUN_ARGS='--logs 20 --peer FIGAROH')"
	@echo "make study-systems  measure accuracy on the seven mechanical systems (takes long)"
	@echo "make study-NAME     run a study of studies/ (takes long; resumes; RUN_ARGS='--jobs 2 --trials 1'); NAME one of"
	@echo "                    $(STUDIES)"
	@echo "make table1         run the first table of the paper (takes long; resumes; RUN_ARGS='--jobs 2 --trials 1')"
	@echo "make table2         run its second table: missing samples, no regularisation (takes long; resumes)"
	@echo "make figures        draw the figures of the reproduction"
	@echo "make reproduce-smoke  one small case by the fast methods, and its tables in build/reproduction/"
	@echo "make clean          remove outputs and caches, keep $(VENV)"

demo: $(STAMPS)/core
	$(BIN)/leastaction demo --output demo-output

# Workers have one BLAS thread each: small matrices gain nothing from more threads. Each takes a part of the
# files in a row, so that what the tests of a file share is computed once, and then steals from the others.
test: $(STAMPS)/test
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -q $(TEST_ARGS)

# Kernels of OpenBLAS round differently: results must not depend on the processor. Thorough tests of other folders
# run once.
test-kernels: $(STAMPS)/test
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/test_kernels.py $(KERNELS) -- -n $(WORKERS) -q $(TEST_ARGS)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) -q -m thorough \
	  tests/app tests/arms tests/cli tests/data tests/exporters tests/reproduction tests/studies tests/test_docs.py

lint: $(STAMPS)/lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports --no-logo

format: $(STAMPS)/lint
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

# Everything anew: a page that an older version of the package has made must not stay. Warnings are errors.
docs: $(STAMPS)/docs
	rm -rf docs/_build docs/gallery docs/reproduction
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sphinx \
	  -q -n -W --keep-going -b html -d docs/_build/doctrees docs docs/_build/html
	$(BIN)/python docs/check_pages.py docs/_build/html
	@echo "open docs/_build/html/index.html"

# Versions lie side by side; the pages of each read the list of all when they are opened.
docs-site: export DOCS_SITE := 1
docs-site: docs
	version=$$($(BIN)/python -c 'import importlib.metadata as m; print(m.version("leastaction"))'); \
	  mkdir -p site && rm -rf site/$$version && cp -R docs/_build/html site/$$version
	$(BIN)/python docs/check_pages.py --versions site

# The wheel is built from the source distribution, so that shows gaps in either; then the wheel runs the smaller demo.
package: $(STAMPS)/package
	rm -rf dist build/package && mkdir -p build
	$(BIN)/python -m build
	$(BIN)/python -m twine check --strict dist/*
	$(BIN)/python -m pip install -q --no-deps --no-index --target build/package dist/*.whl
	cd build && export PYTHONPATH=$(CURDIR)/build/package && \
	  ../$(BIN)/python -c 'import leastaction; assert "build/package" in leastaction.__file__' && \
	  ../$(BIN)/python -m leastaction demo --system single --output package/demo-output

gallery: $(STAMPS)/test
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -q -m slow tests/test_docs.py

bench: $(STAMPS)/core
	$(BIN)/python benchmarks/run.py

# What has a record in build/arms.jsonl is not run again. Peers that are not installed are left out.
bench-arms: $(STAMPS)/core
	$(BIN)/python -m benchmarks.arms $(RUN_ARGS)

study-systems: $(STAMPS)/core
	$(BIN)/python -m benchmarks.intervals systems --sets 3 --noise 0 0.01 0.1

# What has a record in studies/results/NAME.jsonl is not run again.
$(STUDIES:%=study-%): study-%: $(STAMPS)/core
	$(BIN)/python -m studies.run $* $(RUN_ARGS)
	$(BIN)/python -m studies.collate $*

# What has a record in reproduction/results/runs.jsonl is not run again.
table1 table2: table%: $(STAMPS)/reproduction
	$(BIN)/python -m reproduction.run --table $* $(RUN_ARGS)
	$(BIN)/python -m reproduction.collate

figures: $(STAMPS)/reproduction
	$(BIN)/python -m reproduction.figures

SMOKE_METHODS := ours adam:short xlsindy_exact xlsindy_positions energy rk4_sindy
reproduce-smoke: $(STAMPS)/reproduction
	rm -rf build/reproduction
	$(BIN)/python -m reproduction.run --strict --system single_pendulum --noise 0.01 --trials 1 --jobs 2 \
	  --timeout 120 $(SMOKE_METHODS:%=--method %) --results build/reproduction/results
	$(BIN)/python -m reproduction.collate --results build/reproduction/results --output build/reproduction/tables

clean:
	rm -rf demo-output build dist docs/_build docs/gallery docs/reproduction .pytest_cache .hypothesis .ruff_cache .import_linter_cache
	find src tests benchmarks examples docs reproduction runner studies -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true

# A working environment is kept, whoever made it; a broken or too old one is made anew.
$(STAMPS)/venv:
	@if ! $(BIN)/python -c 'import sys, pip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
	  found=; \
	  for candidate in $(PYTHON); do \
	    if "$$candidate" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; \
	    then found=$$candidate; break; fi; \
	  done; \
	  if [ -z "$$found" ]; then \
	    echo "error: no Python >= 3.11 with the venv module among: $(PYTHON)." \
	      "Install one, or name one: make PYTHON=/path/to/python3" >&2; exit 1; \
	  fi; \
	  echo "creating $(VENV) with $$found"; \
	  "$$found" -m venv --clear $(VENV) || exit 1; \
	fi
	@mkdir -p $(STAMPS) && touch $@

# Editable, so that only a change of pyproject.toml asks for a new installation. pip compiles with one processor,
# which takes a third of the time; some files of packages are templates, which no Python can compile.
install = echo "installing leastaction$(1) into $(VENV)"; \
	$(BIN)/python -m pip install -q --no-compile -e '.$(1)' || { echo "error: pip could not install" \
	  "leastaction$(1): see above; it needs a package index" >&2; exit 1; }; \
	$(BIN)/python -m compileall -q -j 0 $(VENV)/lib >/dev/null 2>&1 || true

$(STAMPS)/core: $(STAMPS)/venv pyproject.toml
	@$(call install,)
	@touch $@

$(STAMPS)/test: $(STAMPS)/venv pyproject.toml
	@$(call install,[test])
	@touch $(STAMPS)/core $@

$(STAMPS)/lint: $(STAMPS)/venv pyproject.toml
	@$(call install,[lint])
	@touch $(STAMPS)/core $@

$(STAMPS)/package: $(STAMPS)/venv pyproject.toml
	@$(call install,[package])
	@touch $(STAMPS)/core $@

$(STAMPS)/docs: $(STAMPS)/venv pyproject.toml
	@$(call install,[docs])
	@touch $(STAMPS)/core $@

$(STAMPS)/reproduction: $(STAMPS)/venv pyproject.toml
	@$(call install,[reproduction])
	@touch $(STAMPS)/core $@
