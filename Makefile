# Every target sets up what it needs: a machine with Python 3.11 or newer and its venv module is enough; uv is used when present.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
BENCH := .venv-bench
NEWEST := .venv-newest
DOCS := .venv-docs
EXTRAS := all,dev

.PHONY: setup demo check test night test-native test-newest lint bench docs release clean

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
		$(BIN)/python -m pytest -n 2 --dist loadgroup --no-loadscope-reorder -m "not optimized" $$($(BIN)/python tests/sources.py)

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

# traced programs, kernels, and of the contract what is compiled, mapped and differentiated, once more, on the newest Python that is here and
# the newest JAX for it
MOVED := compiled_once or vmapped or eager or derivative or form or not float32
KERNELS := tests/native/test_blocks.py tests/native/test_translate.py tests/native/test_math.py
test-newest:
	@newest=$$($(PYTHON) tests/newest.py) && if [ -z "$$newest" ]; then \
		echo "test-newest: no Python 3.12 or newer on this machine, nothing tested"; \
	else \
		$(MAKE) --no-print-directory setup VENV=$(NEWEST) PYTHON="$$newest" EXTRAS=test && \
		export XLA_FLAGS="$$($(NEWEST)/bin/python tests/quick.py)" && \
		$(NEWEST)/bin/python -m pytest -n 2 --dist loadgroup -m "not optimized" -k "$(MOVED)" tests/contract tests/tracing $(KERNELS); \
	fi

lint: $(STAMP)
	@$(BIN)/ruff check .
	@$(BIN)/pyright
	@$(BIN)/pyright -p tests/typing --pythonpath $(BIN)/python
	@$(BIN)/python tests/layering/budgets.py

# the site under out/site, without a network and with warnings as errors; tutorials are run, and kept in out/notebooks until they
# change. Notebooks of the examples are written; MOTES_NIGHTLY=1 runs them, which takes an hour
docs:
	@$(MAKE) --no-print-directory setup VENV=$(DOCS) EXTRAS=all,docs
	@$(DOCS)/bin/python -m sphinx -q -W --keep-going -b html -c docs . out/site
	@echo "out/site/index.html"

# a wheel and a source distribution under dist, checked
release: $(STAMP)
	@rm -rf dist
	@$(BIN)/python -m build
	@$(BIN)/python -m twine check --strict dist/*

bench: $(BENCH)/.installed
	@$(BENCH)/bin/python benchmarks/run.py

$(BENCH)/.installed: pyproject.toml benchmarks/environment.py
	@$(PYTHON) benchmarks/environment.py $(BENCH)
	@touch $(BENCH)/.installed

clean:
	rm -rf $(VENV) $(NEWEST) $(BENCH) $(DOCS) .jax out build dist .pytest_cache .ruff_cache .hypothesis docs/api examples/*/*.ipynb
