# `make demo`, `make test` and `make live` need nothing but Python 3.11 or newer and make: what else they need is put into .venv.

BIN := .venv/bin
PIP := $(BIN)/python -m pip install --disable-pip-version-check -q
# Byte code is written when a module is first imported, of those that are: writing it all at installation costs seconds for nothing.
PIP += --no-compile
# Not writing it at all, as some environments ask, makes every process compile numpy and scipy again: a fifth of the test run.
unexport PYTHONDONTWRITEBYTECODE
INSTALLED := .venv/installed

# The first of these that is new enough and can make virtual environments.
PYTHONS := python3 python3.14 python3.13 python3.12 python3.11
USABLE := import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))
define FIND_PYTHON
python=; for each in $(PYTHONS); do if $$each -c '$(USABLE)' 2>/dev/null; then python=$$each; break; fi; done; \
if [ -z "$$python" ]; then \
  echo "No Python 3.11 or newer with venv and ensurepip found (tried: $(PYTHONS)); on Debian: apt-get install python3-venv" >&2; \
  exit 1; \
fi
endef

# The slow tests take minutes: always in CI, elsewhere by `make test CI=1`.
SELECT := $(if $(CI),-m "not vm",-m "not slow")

.PHONY: demo live test bench lint format lock clean

demo: $(INSTALLED)
	$(BIN)/hil demo --out demo

live: $(INSTALLED)
	$(BIN)/hil demo --out demo --live

# Two workers share the processors: more threads of linear algebra in each would be in each other's way.
test: lint
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal $(SELECT)
ifdef CI
	$(BIN)/python -m pytest tests/vcan -m vm
endif

bench: $(INSTALLED)
	$(BIN)/python -m benchmarks --out docs/performance.md

lint: $(INSTALLED)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

format: $(INSTALLED)
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

# Two stamps, so that an edit in pyproject.toml costs two seconds and not a new environment.
.venv/locked: requirements.lock
	@$(FIND_PYTHON); $(BIN)/python -m pip --version >/dev/null 2>&1 || "$$python" -m venv --clear .venv
	@echo "Installing requirements.lock into .venv (about half a minute, once)"
	@$(PIP) --require-hashes -r requirements.lock
	@touch $@

$(INSTALLED): .venv/locked pyproject.toml
	@$(PIP) --no-deps --no-build-isolation --editable .
	@touch $@

# One lock for every supported Python. Pins stay as they are unless pyproject.toml forces them: `make lock UPGRADE=--upgrade` renews all.
lock:
	@$(FIND_PYTHON); "$$python" -m venv .venv-lock
	.venv-lock/bin/python -m pip install --disable-pip-version-check -q uv
	.venv-lock/bin/uv pip compile -q --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
	  --extra test --group build --custom-compile-command "make lock" $(UPGRADE) --output-file requirements.lock pyproject.toml

clean:
	rm -rf .venv .venv-lock .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache build demo *.egg-info
	find drive_profiles hil plant_emulator tests -name __pycache__ -prune -exec rm -rf {} +
