# Every target sets up what it needs: a machine with Python 3.11 or newer and its venv module is enough; uv is used when present.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
BENCH := .venv-bench
NEWEST := .venv-newest
EXTRAS := all,dev

.PHONY: setup demo check test night test-native test-newest lint bench clean

setup: $(STAMP)

$(STAMP): pyproject.toml
	@if command -v uv >/dev/null 2>&1; then \
		test -d $(VENV) || uv venv -q --python $(PYTHON) $(VENV); \
		uv pip install -q --python $(BIN)/python -e '.[$(EXTRAS)]'; \
	else \
		test -x $(BIN)/python || $(PYTHON) -m venv $(VENV); \
		$(BIN)/python -m pip install -q --disable-pip-version-check -e '.[$(EXTRAS)]'; \
	fi
	@touch $(STAMP)

demo: $(STAMP)
	@$(BIN)/motes demo

# an answer within three minutes: lint, and the tests that a change can affect, nearest first, as many as two minutes allow; what is compiled
# is kept in .jax for the next time
check: lint
	@XLA_FLAGS="$$($(BIN)/python tests/quick.py)" MOTES_SECONDS=110 JAX_COMPILATION_CACHE_DIR=$(CURDIR)/.jax JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0.2 \
		$(BIN)/python -m pytest -n 2 --dist loadgroup -m "not optimized" $$($(BIN)/python tests/sources.py)

# quick.py: compiles three times as fast; what asks for the full compiler is marked "optimized". Both processes share what they compile, and
# it is kept in .jax for the next time
test: export JAX_COMPILATION_CACHE_DIR ?= $(CURDIR)/.jax
test: export JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS ?= 0.2
test: $(STAMP)
	@XLA_FLAGS="$$($(BIN)/python tests/quick.py)" $(BIN)/python -m pytest -n 2 --dist loadgroup -m "not optimized"
	@$(BIN)/python -m pytest -n 2 --dist loadgroup -m optimized

# what takes too long for every change, and more of what does not
night:
	@MOTES_NIGHTLY=1 $(MAKE) --no-print-directory test

# the tests that run filters, once more with the native engine; CI asks for the contract alone
NATIVE := tests/contract tests/filters tests/oracles tests/applications tests/laws tests/resampling
test-native: $(STAMP)
	@XLA_FLAGS="$$($(BIN)/python tests/quick.py)" MOTES_ENGINE=native $(BIN)/python -m pytest -n 2 --dist loadgroup -m "not optimized" $(NATIVE)
	@MOTES_ENGINE=native $(BIN)/python -m pytest -n 2 --dist loadgroup -m optimized $(NATIVE)

# the contract, traced programs and kernels once more, on the newest Python that is here and the newest JAX for it
KERNELS := tests/native/test_blocks.py tests/native/test_translate.py tests/native/test_math.py
test-newest:
	@newest=$$($(PYTHON) tests/newest.py) && if [ -z "$$newest" ]; then \
		echo "test-newest: no Python 3.12 or newer on this machine, nothing tested"; \
	else \
		$(MAKE) --no-print-directory setup VENV=$(NEWEST) PYTHON="$$newest" EXTRAS=test && \
		export XLA_FLAGS="$$($(NEWEST)/bin/python tests/quick.py)" && \
		$(NEWEST)/bin/python -m pytest -n 2 --dist loadgroup -m "not optimized" tests/contract tests/tracing $(KERNELS); \
	fi

lint: $(STAMP)
	@$(BIN)/ruff check .
	@$(BIN)/pyright
	@$(BIN)/pyright -p tests/typing --pythonpath $(BIN)/python
	@$(BIN)/python tests/layering/budgets.py

bench: $(BENCH)/.installed
	@$(BENCH)/bin/python benchmarks/run.py

$(BENCH)/.installed: pyproject.toml benchmarks/environment.py
	@$(PYTHON) benchmarks/environment.py $(BENCH)
	@touch $(BENCH)/.installed

clean:
	rm -rf $(VENV) $(NEWEST) $(BENCH) .jax out build dist .pytest_cache .ruff_cache .hypothesis
