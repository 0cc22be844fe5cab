# Every target does its own set-up on a machine that has only Python, pip and apt.

# Where containers set it, every process would compile its imports anew, for more than a second.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help packages setup demo test test-pipelines test-small collected oldest newest lint docs bench dist bundle audit clean

help:
	@echo "make demo    the whole pipeline on a built-in scene, with accuracy and latency at the end"
	@echo "make test    all tests"
	@echo "make oldest  all tests with the oldest versions that pyproject.toml allows; make newest: with the newest"
	@echo "make setup   .venv with everything (command line: .venv/bin/huepose)"
	@echo "make lint    style, types, the import contract, insecure code, secrets"
	@echo "make docs    the documentation as a site in build/docs"
	@echo "make dist    wheel and sdist in build/dist, tried in an empty environment"
	@echo "make bundle  all that an installation without internet needs, in build/bundle (TARGETS=\"aarch64-3.10 ...\")"
	@echo "make audit   known holes in what it depends on (asks the network)"
	@echo "make bench   time of every stage"

# Without what setup compiles and draws, which takes minutes.
packages:
	@./deploy/setup.sh

setup: packages
	@./deploy/first_time.sh

demo: setup
	@.venv/bin/huepose demo

# One thread for the libraries of each process: those of several would wait spinning for each other. One process more
# than processors, since some tests wait. Live tests wait most of the time: those that measure time, or whose pipeline
# has to keep up, run one after the other, and meanwhile so do the others. All find the reference models that the first
# ones make in one folder.
test: export TEST_SHELF = $(CURDIR)/build/shelf
test: setup
	@rm -rf build/shelf
	@OMP_NUM_THREADS=1 .venv/bin/pytest -n $$(($$(nproc) + 1)) --dist worksteal -m "not live"
	@$(MAKE) --no-print-directory --jobs=2 test-pipelines test-small

test-pipelines:
	@.venv/bin/pytest -m "live and pipeline"

test-small:
	@.venv/bin/pytest -m "live and not pipeline"

# Compiles the test files for Python, and the kernels of the paper's methods, which setup leaves out. Else each process of
# `make test` would, all at the same time.
collected: packages
	@said=$$(.venv/bin/pytest --collect-only) || { echo "$$said"; exit 1; }
	@said=$$(.venv/bin/pytest tests/paper/extended/test_colorpair.py) || { echo "$$said"; exit 1; }

# In a clone of the last commit. With another Python: make oldest PYTHON=python3.10
oldest: RESOLVED = --resolution lowest-direct
newest: RESOLVED = --upgrade
oldest newest:
	@rm -rf build/$@ && git clone -q . build/$@
	@cd build/$@ && ./deploy/setup.sh && .tools/uv-*/bin/uv lock --quiet $(RESOLVED)
	@$(MAKE) --no-print-directory -C build/$@ test

lint: packages
	@.venv/bin/ruff check .
	@.venv/bin/ruff format --check .
	@.venv/bin/mypy
	@.venv/bin/lint-imports
	@git ls-files -z | xargs -0 .venv/bin/detect-secrets-hook --no-verify --exclude-lines 'sha256|"[0-9a-f]{64}"'

docs: packages
	@NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict

dist: packages
	@./deploy/try_wheel.sh

bundle: packages
	@./deploy/bundle.sh $(TARGETS)

audit: packages
	@./deploy/audit.sh

bench: setup
	@mkdir -p build
	@.venv/bin/huepose bench all --json build/bench.json

clean:
	rm -rf .venv .tools build
