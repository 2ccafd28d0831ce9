# `make play` and `make test` need nothing but Python 3.11 to 3.13 and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SONG ?= TwinkleTwinkleLittleStar
# The shell takes it from its environment: make and the shell change nothing, whatever its characters.
override export SONG := $(value SONG)

.PHONY: play studio install test smoke check docs films tables bench sb3 lock licences release-check clean
.DEFAULT_GOAL := help

.PHONY: help
help:
	@echo "make play    two robot hands play SONG=$$SONG, and leave a page to open"
	@echo "make studio  a page to drop songs on, which the hands play while you watch"
	@echo "make install  everything that Cadenza can use, such as JAX for training"
	@echo "make test    run the tests"
	@echo "make smoke   a minute of them, and the linter, before each commit"
	@echo "make check   lint, formatting, types"
	@echo "make docs    the documentation as a site, with the reference"
	@echo "make films   the same with films of what was practised; ten minutes without a graphics card"
	@echo "make tables  write the tables of the documentation anew from docs/results"
	@echo "make bench   measure speed, as ratios in one run"
	@echo "make release-check  all that must hold before a release; half an hour, and needs uv"
	@echo "make sb3     test the environments with Stable-Baselines3, which installs gigabytes"

# Two lock files, which agree, pin every version: of what playing and the studio need, and of everything.
# A stamp for each is renewed when it or the project changes.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
PLAYS := $(VENV)/plays
ALL := $(VENV)/installed

$(PLAYS): pyproject.toml requirements.lock
	$(PYTHON) -c 'import sys; assert (3, 11) <= sys.version_info[:2] <= (3, 13), "cadenza needs Python 3.11 to 3.13, this is " + sys.version.split()[0] + ": make PYTHON=python3.11"'
	$(PYTHON) -m venv $(VENV)
	$(PIP) -r requirements.lock
	$(PIP) --no-deps --editable .
	@touch $@

$(ALL): $(PLAYS) requirements-dev.lock
	$(PIP) -r requirements-dev.lock
	@touch $@

play: $(PLAYS)
	$(BIN)/cadenza play -- "$$SONG"

studio: $(PLAYS)
	$(BIN)/cadenza studio

install: $(ALL)

# In two processes of 2 to 3 GB each. Tests of one file stay together, as they share what they set up.
test: $(ALL)
	$(BIN)/python -m pytest -n 2

# A minute on two cores, for each commit: quick tests of every folder, and what may differ from one Python to another.
SMOKE := api configs registry layering docs release cards errors cli_options tasks/env \
	tasks/piano_task tasks/reward tasks/parity music/midi music/score music/goals music/playing_metrics \
	music/written_hands music/bars agents/misses learning/networks \
	learning/replay_buffer demonstrations/dataset evaluation/statistics \
	evaluation/results report/performance_page report/summary_page studio/requests
SMOKE_TESTS := tests/hands tests/keyboards tests/scene tests/sim tests/fingering $(foreach name,$(SMOKE),$(dir tests/$(name))test_$(notdir $(name)).py)

# Another Python than that of `make test` has only the packages that these need, of the same versions.
SMOKES := $(VENV)/smokes
SMOKE_NEEDS := flax hypothesis huggingface-hub jax mir_eval moviepy pytest pytest-xdist ruff

$(SMOKES): $(PLAYS) requirements-dev.lock
	test -e $(ALL) || $(PIP) --constraint requirements-dev.lock $(SMOKE_NEEDS)
	@touch $@

smoke: $(SMOKES)
	$(BIN)/ruff check --quiet
	$(BIN)/ruff format --check --quiet
	$(BIN)/python -m pytest -n 2 $(SMOKE_TESTS)

check: $(ALL)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

# What its front page plays is played again when Cadenza has changed, which takes a minute.
PLAYED := build/docs/gallery/gallery.json

$(PLAYED): docs/gallery.py $(shell find src/cadenza -type f -not -path '*/__pycache__/*') | $(ALL)
	$(BIN)/python docs/gallery.py $(@D)

docs: $(ALL) $(PLAYED)
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet docs build/docs
	@echo "open build/docs/index.html"

films: $(PLAYED)
	$(BIN)/python docs/gallery.py films $(dir $(PLAYED))
	$(MAKE) docs

tables: $(ALL)
	$(BIN)/python tools/write_tables.py

bench: $(ALL)
	@test -x .venv-published/bin/python || tools/published_setup.sh .venv-published || echo "without the published environment to compare with"
	$(BIN)/python -m benchmarks.speed tests/data/episode_d.npz $$(test -x .venv-published/bin/python && echo --published .venv-published)

# Not in $(VENV): it brings PyTorch.
sb3:
	$(PYTHON) -m venv .venv-sb3
	.venv-sb3/bin/python -m pip install --quiet torch --index-url https://download.pytorch.org/whl/cpu
	.venv-sb3/bin/python -m pip install --quiet --editable . 'stable-baselines3>=2.7,<3' 'pytest>=8,<10' 'pytest-xdist>=3.8,<4'
	.venv-sb3/bin/python -m pytest -m slow tests/test_examples.py -k stable_baselines3

lock:
	uv pip compile pyproject.toml --group dev --universal --python-version 3.11 --output-file requirements-dev.lock
	uv pip compile pyproject.toml --extra studio --universal --python-version 3.11 --constraint requirements-dev.lock --output-file requirements.lock

# What packages say of themselves. MPL and LGPL bind whoever changes those packages, not who uses them.
LICENCES := 0BSD;AFL;Apache;BSD;CC0;ISC;LGPL;MIT;MPL;Mozilla Public License;PSF;Public Domain;Python Software;Zlib
licences:
	@mkdir -p build
	uv tool run --quiet --python 3.11 --with-requirements requirements-dev.lock pip-licenses@5.5.5 --from mixed \
		--format csv --partial-match --allow-only '$(LICENCES)' --output-file build/licences.csv
	awk -F '","' 'NR > 1 { gsub(/"/, "", $$1); gsub(/"/, "", $$3); names[$$3] = names[$$3] ", " $$1 } \
		END { for (licence in names) print "| " licence " | " substr(names[licence], 3) " |" }' \
		build/licences.csv | LC_ALL=C sort -f > build/table.md
	sed '/^| ---/q' docs/licences.md | cat - build/table.md > build/licences.md
	mv build/licences.md docs/licences.md

release-check:
	$(PYTHON) tools/release_check.py

clean:
	rm -rf $(VENV) .venv-sb3 .venv-3.* .pytest_cache .ruff_cache .mypy_cache
