# Every target does its own set-up on a machine that has only Python, pip and apt.
.PHONY: help setup demo test lint bench clean

help:
	@echo "make demo    the whole pipeline on a built-in scene, with accuracy and latency at the end"
	@echo "make test    all tests"
	@echo "make setup   .venv with everything (command line: .venv/bin/huepose)"
	@echo "make lint    style, types and the import contract"
	@echo "make bench   time of every stage"

setup:
	@./deploy/setup.sh

demo: setup
	@.venv/bin/huepose demo

test: setup
	@.venv/bin/pytest -n auto --dist worksteal -m "not live"
	@.venv/bin/pytest -m live

lint: setup
	@.venv/bin/ruff check .
	@.venv/bin/ruff format --check .
	@.venv/bin/mypy
	@.venv/bin/lint-imports

bench: setup
	@mkdir -p build
	@.venv/bin/huepose bench all --json build/bench.json

clean:
	rm -rf .venv .tools build
