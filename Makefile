# `make demo`, `make test` and `make live` need nothing but Python 3.11 or newer and make: what else they need is put into .venv.

BIN := .venv/bin
# The locks are complete, so pip resolves nothing: a release of anybody else's changes no installation, and any pip from 23.0 will do.
# uv takes 8 s for the packages of the tests where one pip takes 53 (two cores), hence two. pip all the same: it comes with
# Python, it knows the mirror and the proxy that a company has set up for it, and a file that uv could sync from names the hosts
# of its packages.
# Byte code is written when a module is first imported, of those that are: writing it all at installation costs seconds for nothing.
PIP := $(BIN)/python -m pip install --disable-pip-version-check -q --no-compile --no-deps --no-build-isolation
# Not writing it at all, as some environments ask, makes every process compile numpy and scipy again: a fifth of the test run.
unexport PYTHONDONTWRITEBYTECODE
INSTALLED := .venv/installed
TESTABLE := .venv/testable

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

# A .venv that is there is used, whoever made it; it is never deleted.
define FIND_VENV
if [ ! -e .venv ]; then $(FIND_PYTHON); "$$python" -m venv .venv && touch .venv/made; fi; \
if ! $(BIN)/python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
  echo ".venv has no Python 3.11 or newer that starts; move it away or remove it, then run make again" >&2; exit 1; \
fi; \
$(BIN)/python -m pip --version >/dev/null 2>&1 || $(BIN)/python -m ensurepip >/dev/null || \
  { echo ".venv has no pip, and its Python cannot install one (ensurepip); install pip into it, or move it away" >&2; exit 1; }
endef

.PHONY: demo live pytest test test-all bench lint format lock clean

demo: $(INSTALLED)
	$(BIN)/hil demo --out demo --force

live: $(INSTALLED)
	$(BIN)/hil demo --out demo --force --live

pytest: $(TESTABLE)

test: $(TESTABLE)
	$(BIN)/python -m tests.stages $(if $(CI),ci,everyday) $(if $(SINCE),--since $(SINCE))

test-all: $(TESTABLE)
	$(BIN)/python -m tests.stages all

bench: $(INSTALLED)
	$(BIN)/python -m benchmarks master bench node sdo robustness startup --out docs/performance.md
	$(BIN)/python -m benchmarks plant growth memory runs --title "Performance: growth and long runs" \
	  --out docs/performance-growth.md

lint: $(TESTABLE)
	$(BIN)/python -m tests.stages lint

format: $(TESTABLE)
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

# pip works on one processor: two of them install every second package of a lock each.
HALVE := import re, sys; \
each = re.findall(r"(?m)^[^ \#\n].*\n(?: .*\n)*", open(sys.argv[1], encoding="utf-8").read()); \
[open(f".venv/half-{half}.lock", "w", encoding="utf-8").writelines(each[half::2]) for half in (0, 1)]
define INSTALL
echo "Installing $(1) into .venv (about $(2), once)"; \
$(BIN)/python -c '$(HALVE)' $(1) || exit 1; \
$(PIP) --require-hashes -r .venv/half-0.lock & first=$$!; \
$(PIP) --require-hashes -r .venv/half-1.lock; second=$$?; wait $$first && [ $$second = 0 ] && \
rm .venv/half-0.lock .venv/half-1.lock
endef

# Two stamps, so that an edit in pyproject.toml costs two seconds and not an installation.
.venv/locked: requirements.lock
	@$(FIND_VENV)
	@$(call INSTALL,requirements.lock,20 seconds)
	@touch $@

# The core is C: where the machine has no compiler, one comes from PyPI.
$(INSTALLED): .venv/locked pyproject.toml requirements-compiler.lock
	@if ! $(BIN)/python -c 'from hil.core.build import compiler; compiler()' 2>/dev/null; then \
	  echo "There is no C compiler: installing requirements-compiler.lock into .venv (400 MB)"; \
	  $(PIP) --require-hashes -r requirements-compiler.lock; \
	fi
	@$(PIP) --editable .
	@touch $@

$(TESTABLE): $(INSTALLED) requirements-test.lock
	@$(call INSTALL,requirements-test.lock,20 seconds)
	@touch $@

# One lock for the demo and one for the tests, each for every supported Python; both hold the same version of what is in both.
# Pins stay as they are unless pyproject.toml forces them: `make lock UPGRADE=--upgrade` renews all.
UV_VERSION := 0.13.9
COMPILE = .venv-lock/bin/uv pip compile -q --universal --python-version 3.11 --fork-strategy fewest --generate-hashes --no-annotate \
  --custom-compile-command "make lock" --group build
lock:
	@$(FIND_PYTHON); "$$python" -m venv .venv-lock
	.venv-lock/bin/python -m pip install --disable-pip-version-check -q uv==$(UV_VERSION)
	$(COMPILE) --group test --extra cluster --extra dbc --extra live --extra mcap --extra mf4 --extra parquet $(UPGRADE) \
	  --output-file requirements-test.lock pyproject.toml
	$(COMPILE) --extra live --constraint requirements-test.lock $(UPGRADE) --output-file requirements.lock pyproject.toml
	.venv-lock/bin/uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-annotate --custom-compile-command "make lock" \
	  --group compiler $(UPGRADE) --output-file requirements-compiler.lock

# A .venv that something else made stays.
clean:
	if [ -e .venv/made ]; then rm -rf .venv; fi
	rm -rf .venv-lock .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache build demo *.egg-info
	find drive_profiles hil plant_emulator tests -name __pycache__ -prune -exec rm -rf {} +
