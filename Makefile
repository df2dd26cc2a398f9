# The chores of the workbench. `make` lists them; each one first sees to the environment it needs, which
# takes a minute the first time and milliseconds after that. A machine with git, make and Python is enough.
#
#   make report ARGS="--states 3"       ARGS goes to the command behind the target
#   make env PYTHON=/path/to/python     names the Python to use, should none be found

.DEFAULT_GOAL := help
.PHONY: help env report docs evidence notebooks notebooks-fast test test-all lint format warm bench lock clean distclean

BIN := .venv/bin
OUT := reports/build
ARGS ?=

# A machine that is told not to keep compiled Python would compile every library anew with every command: seconds each.
unexport PYTHONDONTWRITEBYTECODE

help: ## This list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-16s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

# Said where somebody asked for the environment itself, and not before each of the other chores.
READY := .venv is ready. Next: .venv/bin/prosocial shows the first steps; make report makes the whole report
env: ## Make or repair .venv exactly as requirements.lock says
	@sh .ci/environment .venv requirements.lock
	$(if $(filter env,$(MAKECMDGOALS)),@echo "$(READY)")

report: env ## The whole report on the bundled data, into reports/build (OUT=folder)
	$(BIN)/prosocial report --out $(OUT) $(ARGS)

docs: env ## The documentation site, into reports/build/site
	$(BIN)/python reports/docs/commands.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet -f reports/docs/mkdocs.yml

# Each command replaces its file when it is done, so that an interruption leaves the last evidence in place.
evidence: env ## Make anew the stored evidence, calibration and recovery (an hour on two cores)
	$(BIN)/prosocial calibrate --states 2,3 --replicates 200,100 --out reports/evidence/calibration.json
	$(BIN)/prosocial calibrate --people-differ --replicates 100 --out reports/evidence/calibration_people.json
	$(BIN)/prosocial recover --states 1-5 --select --replicates 50 --out reports/evidence/recovery.json
	$(BIN)/prosocial coverage --studies 500 --out reports/evidence/mixed_model.json
	$(BIN)/prosocial power mixed-model --out reports/evidence/power_mixed_model.json
	$(BIN)/prosocial power contraction --out reports/evidence/power_contraction.json
	$(BIN)/prosocial replicate game --out reports/evidence/game.json
	$(BIN)/prosocial replicate study2 --out reports/evidence/study2.json
	$(BIN)/prosocial replicate plans --replicates 200 --out reports/evidence/plans_in_truth.json

notebooks: env ## Run every notebook and store its output
	$(BIN)/python -m analysis.notebooks $(ARGS)

notebooks-fast: env ## Run every notebook with few draws, to see that it still runs; stores nothing
	$(BIN)/python -m analysis.notebooks --fast $(ARGS)

test: env ## Tests and docstring examples, without the slow ones (ARGS="-k em" picks some)
	$(BIN)/python -m pytest -n 2 --dist loadfile $(ARGS)

test-all: env ## All tests, the slow ones too
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "" $(ARGS)

lint: env ## Style, formatting and types; changes nothing
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: env ## Mend what style and formatting can mend by themselves
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

warm: env ## Compile every kernel a report needs, so that no later command pays for it
	@out=$$(mktemp -d) && trap 'rm -rf "$$out"' EXIT && $(BIN)/prosocial report --quick --quiet --out "$$out"

# The peers get an environment of their own. Their lock is made under the constraint of ours, so every version
# they share is the same; but a package that happens to be importable changes what others do (optional imports),
# and the tests must never lean on one that only the benchmarks install.
# What the documentation shows is measured by ARGS="all --out reports/evidence/bench.json" on an idle machine.
bench: ## Measure the workbench against its peers (ARGS=name for one)
	@sh .ci/environment .venv-bench requirements-bench.lock
	.venv-bench/bin/prosocial bench $(ARGS)

# Hashes only: no address of any package index gets into a lock file.
COMPILE := $(BIN)/uv pip compile --quiet --universal --python-version 3.12 --generate-hashes --no-header pyproject.toml
lock: env ## Pin anew what pyproject.toml asks for (ARGS=--upgrade for newer versions)
	$(COMPILE) --extra pdf --extra game --group dev --group build --output-file requirements.lock $(ARGS)
	$(COMPILE) --group build --group bench --constraints requirements.lock --override .ci/bench-overrides.txt --output-file requirements-bench.lock $(ARGS)

clean: ## Remove what runs leave behind: built reports, compiled kernels, tools' caches
	rm -rf reports/build .cache/numba .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find models analysis tests -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean ## As clean, and downloads, stored fits and the environments too
	rm -rf .cache .venv .venv-bench
