# `make demo` sets all up and runs the demo; `make test` sets all up and passes all tests.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
RUST   := $(shell find rust -name '*.rs')

.PHONY: help demo test test-rust test-python docs lint bench clean

help: ## List the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/'

demo: $(VENV)/.ready ## Set up, then simulate, register and fuse a dam site into out/demo
	$(BIN)/tmchho demo -o out/demo --overwrite

test: test-rust test-python ## Set up, then run every test, Rust and Python

test-rust: ## The crate alone; needs no Python
	cargo test --quiet

test-python: $(VENV)/.ready ## The Python package, its command line and its examples
	$(BIN)/python -m pytest -q

docs: $(VENV)/.ready ## The documentation site, in out/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

lint: $(VENV)/.ready ## Formatting, lints and types, Rust and Python
	cargo fmt --check
	cargo clippy --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --no-deps --quiet
	PYO3_PYTHON=$(abspath $(BIN)/python) cargo clippy --features python -- -D warnings
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest tmchho._core

bench: ## Criterion benchmarks of every stage
	cargo bench

clean: ## Remove everything that was built
	rm -rf $(VENV) target out

$(BIN)/maturin: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q --upgrade "pip>=25.1" "maturin>=1.16,<2"
	touch $@

$(VENV)/.ready: $(BIN)/maturin pyproject.toml Cargo.toml Cargo.lock $(RUST)
	$(BIN)/maturin develop --release --quiet
	touch $@
