# make demo    sets up, simulates a measuring campaign, runs two nights over it, says what to try next
# make thesis  the same with the tests of a doctoral thesis: three times as many recordings, one night
# make test    sets up and runs the tests: what continuous integration runs
# make long    the tests that take longest: further sessions in which an effect is hidden, further cases of what make test asks
#              once, whole nights, and what is judged over many draws
# make quick   sets up and runs the short tests: unit, readers, and the physics that takes moments
# make bench   benchmarks against other libraries, side by side; writes tests/benchmarks/results.md
# make study   the long statistical studies that the READMEs quote; writes tests/studies/results.md
# make fuzz    the property tests with cases drawn anew, mutated input files for every reader and a search guided by
#              coverage; writes tests/bad_files/results.md
# make faults  kills, full disks, readers and rivals of the nightly, many times, a month of nights with accidents of
#              all kinds, and a lab in older DuckDBs (from PyPI); writes tests/faults/results.md, soak.md and old_duckdb.md
# make docs    renews the generated parts of the READMEs and the pictures (those with Chromium, from the demonstration)
# make lint    formatting, lint, types, the import rule
# make release-check   builds wheel and sdist into dist/, installs the wheel alone with the pinned libraries and tries it outside
#              of the checkout; make release-check PYTHONS="python3.11 python3.13" does so with each of them
# make site    the documents and docstrings as pages that need no network, in build/site; fails on a warning or a broken link
# make audit   asks the advisories of PyPI about every pinned release (needs a network)
# make pins    writes the hashes of the pinned requirements anew, for every supported Python (needs uv)
# make clean   removes environments, caches and the demonstration
#
# Set-up is done once: pip runs again only when a requirements file or pyproject.toml has changed.

PYTHON ?= python3
VENV := .venv
PEERS := .venv-peers
FUZZ := .venv-fuzz
AUDIT := .venv-audit
RELEASE := .venv-release
SITE := .venv-site
BIN := $(VENV)/bin
DEMO := demo

PROPERTIES = $(shell grep -lr --include='test_*.py' '^from hypothesis import' tests)
RUNTIME := $(VENV)/.runtime
DEVELOPMENT := $(VENV)/.development
PIP_FLAGS := --quiet --disable-pip-version-check
PYTHONS ?= $(PYTHON)
SUPPORTED := 3.11 3.12 3.13 3.14
# With hashes where the Python is a supported one; a newer one gets the same versions, unhashed.
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
HASHED = $(if $(filter $(VERSION),$(SUPPORTED)),--require-hashes -r requirements/$(1)-$(VERSION).txt,-r $(2))

.PHONY: demo thesis test long quick bench study fuzz faults docs site lint release-check audit pins clean
.DEFAULT_GOAL := demo

# Exit status 3 is meant: as in real campaigns a recording is damaged, one is refused, and one that nothing describes is not read.
demo: $(RUNTIME)
	$(BIN)/dealab simulate demo --night 1 --out $(DEMO)/raw --truth $(DEMO)/truth.json
	@$(BIN)/dealab nightly $(DEMO)/raw --lab $(DEMO)/lab || [ $$? -eq 3 ]
	@echo
	@echo "The first night asks for recordings:"
	@$(BIN)/dealab sql --lab $(DEMO)/lab "SELECT specimen_id, next_recording FROM diagnoses WHERE next_recording IS NOT NULL"
	@echo
	@echo "The taps for PA-1 are made, and the second night decides; nobody makes those for PA-3, which stays open:"
	$(BIN)/dealab simulate demo --night 2 --out $(DEMO)/raw --truth $(DEMO)/truth.json
	@$(BIN)/dealab nightly $(DEMO)/raw --lab $(DEMO)/lab || [ $$? -eq 3 ]
	@echo
	@$(BIN)/dealab sql --lab $(DEMO)/lab "SELECT specimen_id, verdict, mechanisms FROM diagnoses ORDER BY specimen_id"
	@echo
	@echo "Report:    $(DEMO)/lab/reports/index.html"
	@echo "Database:  $(DEMO)/lab/results.duckdb"
	@echo
	@echo "Try:"
	@echo "  $(BIN)/dealab diagnose PA-3 --lab $(DEMO)/lab"
	@echo "  $(BIN)/dealab sql --lab $(DEMO)/lab 'SELECT specimen_id, model_order FROM best_models'"
	@echo "  $(BIN)/dealab sql --lab $(DEMO)/lab 'SELECT * FROM survival_at(60)'"
	@echo "  $(BIN)/dealab sql --lab $(DEMO)/lab 'SELECT what, name, status, problem FROM needs_attention'"

thesis: $(RUNTIME)
	$(BIN)/dealab simulate thesis --out $(DEMO)/thesis/raw --truth $(DEMO)/thesis/truth.json
	@$(BIN)/dealab nightly $(DEMO)/thesis/raw --lab $(DEMO)/thesis/lab || [ $$? -eq 3 ]

test: $(DEVELOPMENT)
	$(BIN)/python -m pytest -n 2 --dist worksteal -m 'not long and not study'

long: $(DEVELOPMENT)
	$(BIN)/python -m pytest -n 2 --dist worksteal -m 'long or study'

quick: $(DEVELOPMENT)
	$(BIN)/python -m pytest -n 2 --dist worksteal -m quick tests/unit tests/readers tests/physics

bench: $(PEERS)/.ready
	$(PEERS)/bin/python -m tests.benchmarks

study: $(DEVELOPMENT)
	$(BIN)/python -m tests.studies

fuzz: $(DEVELOPMENT) $(FUZZ)/.ready
	DEALAB_HYPOTHESIS=new $(BIN)/python -m pytest -n 2 --dist worksteal $(PROPERTIES)
	$(BIN)/python -m tests.bad_files.fuzz

faults: $(DEVELOPMENT)
	$(BIN)/python -m tests.faults.harness
	$(BIN)/python -m tests.faults.soak
	$(BIN)/python -m tests.faults.old_duckdb

docs: $(DEVELOPMENT)
	$(BIN)/python -m tests.tools.docs --pictures $(wildcard $(DEMO)/lab)

site: $(SITE)/.ready
	$(SITE)/bin/python -m tests.tools.site

lint: $(DEVELOPMENT)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

release-check: $(RELEASE)/.ready
	$(RELEASE)/bin/python -m tests.tools.release $(PYTHONS)

# A release that the advisories do not know is as bad as one with an advisory: nothing is said to be clean that was not asked.
audit: $(AUDIT)/.ready
	for version in $(SUPPORTED); do \
	  $(AUDIT)/bin/pip-audit --strict --disable-pip --require-hashes --requirement requirements/runtime-$$version.txt || exit 1; \
	done

pins:
	for version in $(SUPPORTED); do \
	  uv pip compile --quiet --generate-hashes --only-binary :all: --no-annotate --no-header --python-version $$version \
	    requirements.txt --output-file requirements/runtime-$$version.txt && \
	  uv pip compile --quiet --generate-hashes --only-binary :all: --no-annotate --no-header --python-version $$version \
	    requirements-dev.txt --output-file requirements/development-$$version.txt || exit 1; \
	done
	uv pip compile --quiet --generate-hashes --no-annotate --no-header --universal --python-version 3.11 \
	  --constraint requirements.txt requirements/release.in --output-file requirements/release.txt
	uv pip compile --quiet --generate-hashes --no-annotate --no-header --universal --python-version 3.11 \
	  requirements.txt requirements/site.in --output-file requirements/site.txt

clean:
	rm -rf $(VENV) $(PEERS) $(FUZZ) $(AUDIT) $(RELEASE) $(SITE) $(DEMO) build dist artifacts
	rm -rf .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find schemas ingest pipeline reports tests -name __pycache__ -type d -prune -exec rm -rf {} +

# An environment with the project in it: $(call environment,FOLDER,WHAT PIP INSTALLS)
define environment
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "dealab needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1)." >&2; \
	  echo "Name one: make PYTHON=/path/to/python3.12" >&2; exit 1; }
	@[ -x $(1)/bin/python ] || $(PYTHON) -m venv $(1) || { \
	  echo "Python could not make an environment; on Debian: apt install python3-venv" >&2; rm -rf $(1); exit 1; }
	$(1)/bin/python -m pip install $(PIP_FLAGS) $(2)
	$(1)/bin/python -m pip install $(PIP_FLAGS) --no-deps --no-build-isolation --editable .
endef

$(RUNTIME): requirements.txt pyproject.toml
	$(call environment,$(VENV),$(call HASHED,runtime,requirements.txt))
	@touch $@

$(DEVELOPMENT): requirements.txt requirements-dev.txt pyproject.toml
	$(call environment,$(VENV),$(call HASHED,development,requirements-dev.txt))
	@touch $@ $(RUNTIME)

# Ours first, the peers over it: lifelines asks for a pandas before 3, which only this environment gets.
$(PEERS)/.ready: requirements.txt requirements-dev.txt requirements-peers.txt pyproject.toml
	$(call environment,$(PEERS),$(call HASHED,development,requirements-dev.txt))
	$(PEERS)/bin/python -m pip install $(PIP_FLAGS) -r requirements-peers.txt
	@touch $@

# atheris has no builds for every Python and system: without it the search guided by coverage is left out, and said so.
$(FUZZ)/.ready: requirements.txt requirements-dev.txt pyproject.toml
	$(call environment,$(FUZZ),$(call HASHED,development,requirements-dev.txt))
	$(FUZZ)/bin/python -m pip install $(PIP_FLAGS) atheris==3.0.0 || echo "atheris does not install here"
	@touch $@

$(AUDIT)/.ready:
	$(PYTHON) -m venv $(AUDIT)
	$(AUDIT)/bin/python -m pip install $(PIP_FLAGS) pip-audit==2.10.1
	@touch $@

$(RELEASE)/.ready: requirements/release.txt
	$(PYTHON) -m venv $(RELEASE)
	$(RELEASE)/bin/python -m pip install $(PIP_FLAGS) --require-hashes -r requirements/release.txt
	@touch $@

$(SITE)/.ready: requirements/site.txt
	$(PYTHON) -m venv $(SITE)
	$(SITE)/bin/python -m pip install $(PIP_FLAGS) --require-hashes -r requirements/site.txt
	@touch $@
