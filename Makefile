# `make demo` sets all up and runs the demo; `make test` sets all up and passes all tests.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
RUST   := $(shell find rust -name '*.rs')

.PHONY: help demo test test-rust test-python docs lint package bench clean

help: ## List the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/'

demo: $(VENV)/.built ## Set up, then simulate, register and fuse a dam site into out/demo
	$(BIN)/tmchho demo -o out/demo --overwrite

test: test-rust test-python ## Set up, then run every test, Rust and Python

test-rust: ## The crate alone; needs no Python
	cargo test --quiet

test-python: $(VENV)/.built $(VENV)/.tools ## The Python package, its command line and its examples
	$(BIN)/python -m pytest -q

docs: $(VENV)/.built $(VENV)/.tools ## The documentation site, in out/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

lint: $(VENV)/.built $(VENV)/.tools ## Formatting, lints and types, Rust and Python
	cargo fmt --check
	cargo clippy --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --no-deps --quiet
	PYO3_PYTHON=$(abspath $(BIN)/python) cargo clippy --features python -- -D warnings
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/mypy examples
	$(BIN)/python -m mypy.stubtest tmchho._core

package: $(BIN)/maturin ## The crate, the wheel and the source archive, the latter two tried in clean environments
	cargo package --locked --quiet
	rm -rf out/dist
	$(BIN)/maturin build --release --locked --quiet --out out/dist
	$(BIN)/maturin sdist --out out/dist
	set -e; for archive in out/dist/*; do \
		$(PYTHON) -m venv --clear out/clean; \
		out/clean/bin/python -m pip install -q "$$archive[report]"; \
		out/clean/bin/tmchho doctor; \
		out/clean/bin/tmchho demo --points 60000 -o out/clean/demo; \
	done

bench: ## Criterion benchmarks of every stage
	cargo bench

clean: ## Remove everything that was built
	rm -rf $(VENV) target out

$(BIN)/maturin: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q --upgrade "pip>=25.1" "maturin>=1.16,<2"
	touch $@

# All that the demo needs. What tests, lints and documents need besides is several times as much to fetch.
$(VENV)/.built: $(BIN)/maturin pyproject.toml Cargo.toml Cargo.lock $(RUST)
	@echo "building the Rust core, which takes some minutes"
	$(BIN)/python -m pip install -q --no-build-isolation -e ".[report]"
	touch $@

$(VENV)/.tools: $(BIN)/maturin pyproject.toml
	$(BIN)/python -m pip install -q --group dev
	touch $@
