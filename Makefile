# `make help` lists every target. Nothing but Python 3.11-3.13, make and git is needed beforehand.
SHELL := /bin/bash
.DEFAULT_GOAL := help

PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	command -v $$p >/dev/null 2>&1 && $$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null && echo $$p && break; done)
VENV ?= .venv
BIN := $(VENV)/bin
# Compiled modules are kept whatever the shell says: without them every process reads all of jax's sources again, 2 s of each.
export PYTHONDONTWRITEBYTECODE :=
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
# A lock: by uv, which takes a third of pip's time; by pip where uv does not exist or does not know the way to the packages.
install = { $(PIP) install --require-hashes -r requirements/uv.txt && \
	$(BIN)/python -m uv pip install --quiet --python $(BIN)/python --require-hashes -r $(1); } 2>/dev/null || \
	$(PIP) install --require-hashes -r $(1)

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "cablejax needs Python 3.11, 3.12 or 3.13 on the PATH (or PYTHON=/path/to/python)." >&2; exit 2; }
	@echo "Creating $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.run-stamp: requirements/study.txt pyproject.toml | $(BIN)/python
	@test -e $(VENV)/.dev-stamp || echo "Installing the locked dependencies (half a minute, or two minutes without uv)"
	@test -e $(VENV)/.dev-stamp || { $(call install,$<); }
	@PYTHONWARNINGS=ignore $(PIP) install --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.dev-stamp: requirements/dev.txt pyproject.toml | $(BIN)/python
	@echo "Installing the locked development dependencies (half a minute, or two minutes without uv)"
	@$(call install,$<)
	@PYTHONWARNINGS=ignore $(PIP) install --no-deps --no-build-isolation -e .
	@touch $@ $(VENV)/.run-stamp

$(VENV)/.docs-stamp: requirements/docs.txt $(VENV)/.run-stamp
	@echo "Installing what the documentation is built with"
	@$(call install,$<)
	@touch $@

.PHONY: help setup setup-dev docs release run test test-portable lint format check results reproduce verify tabulate tables paper-tables figures report notebooks lab lock clean
help: ## List every target
	@grep -hE '^[a-zA-Z0-9_-]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  %-22s %s\n", $$1, $$2}'
	@printf "  %-22s Sweep and collect one table or figure (SIZE=smoke, quick or paper)\n" $(EXPERIMENTS)

setup: $(VENV)/.run-stamp ## Create .venv with what `make run` needs

setup-dev: $(VENV)/.dev-stamp ## Create .venv with everything: tests, linters, notebooks, sweeps

# The main job, or with SCAN=file the measuring of your own scan. UNIT is that of the file.
UNIT ?= mm
SIZE ?= quick
ifdef SCAN
run: $(VENV)/.run-stamp
	@$(BIN)/cablejax measure "$(SCAN)" --unit $(UNIT) --report "runs/scans/$(basename $(notdir $(SCAN))).html"
else
run: $(VENV)/.run-stamp ## Do the main job (a few minutes); SCAN=path.ply UNIT=mm measures your own scan instead
	@$(BIN)/python -m experiments.main --size $(SIZE)
endif

PYTEST ?= -n 2 --dist loadfile --no-loadscope-reorder
test: $(VENV)/.dev-stamp ## Run the tests
	@$(BIN)/python -m pytest $(PYTEST)

# The instructions that XLA may use, as on older processors; each keeps what it compiles apart. ISAS="AVX2" for one alone.
ISAS ?= SSE4_2 AVX2 AVX512
TESTS ?=
test-portable: $(VENV)/.dev-stamp ## Tests and verify as on other processors: SSE4.2, AVX2, AVX-512, 1 and 2 threads (hours; TESTS=path)
	@for isa in $(ISAS); do for threads in 1 2; do \
		echo "== $$isa, $$threads thread(s)"; \
		export XLA_FLAGS="--xla_cpu_max_isa=$$isa" NPROC=$$threads OMP_NUM_THREADS=$$threads JAX_COMPILATION_CACHE_DIR="$(CURDIR)/.jax_cache/$$isa-$$threads"; \
		$(BIN)/python -m pytest -q $(PYTEST) $(TESTS) || exit 1; \
		$(if $(TESTS),,$(BIN)/python -m experiments.verify || exit 1;) \
	done; done

lint: $(VENV)/.dev-stamp ## Check format, lint and types
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/basedpyright

format: $(VENV)/.dev-stamp ## Format the sources and mend what the linter can mend
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

check: lint test ## Everything that must pass before a commit

# One target per table and figure: the sweep, then its results file. SEEDS="range(10)" for more seeds than the file says.
OWN := table1_filtering table2_3_deviation diameter robustness
TABLE1 := table1_outliers table1_noise
TRAINED := fig5_alexnet fig6_vgg16 fig7_resnet50 fig8_adgcnn standard_adgcnn hard_adgcnn fig13_optimizers optimizer_search optimizer_study ablation
WITH_DATA := fig13_transfer
EXPERIMENTS := $(OWN) $(TABLE1) $(TRAINED) $(WITH_DATA)
$(OWN): MODULE = $@
$(TABLE1): MODULE = table1_filtering
$(TRAINED) $(WITH_DATA): MODULE = train
$(EXPERIMENTS): $(VENV)/.run-stamp
	@$(BIN)/python -m experiments.$(MODULE) -m experiment=$@ size=$(SIZE) $(if $(SEEDS),"seed=$(SEEDS)")
	@$(BIN)/python -m experiments.collect $@ --size $(SIZE)
.PHONY: $(EXPERIMENTS)
# The seeds of the committed files, where the experiment's own are fewer.
table1_filtering table2_3_deviation: SEEDS ?= range(10)
table1_outliers: SEEDS ?= range(8)
table1_noise: SEEDS ?= range(5)
diameter ablation fig13_optimizers: SEEDS ?= range(3)

# The loss curves of Figures 9-12 are of the runs of Figures 5-8.
fig9_alexnet_loss: fig5_alexnet
fig10_vgg16_loss: fig6_vgg16
fig11_resnet50_loss: fig7_resnet50
fig12_adgcnn_loss: fig8_adgcnn
.PHONY: fig9_alexnet_loss fig10_vgg16_loss fig11_resnet50_loss fig12_adgcnn_loss

# Sizes by a fit to all, kept and true points, and by the network that finds the cable's points first.
rejection: $(VENV)/.run-stamp ## Train adgcnn_fit on hard clouds, three seeds, and test it on every kind
	@$(BIN)/python -m experiments.train -m experiment=hard_adgcnn_fit size=$(SIZE) $(if $(SEEDS),"seed=$(SEEDS)")
	@$(BIN)/python -m experiments.rejection --size $(SIZE)
	@$(BIN)/python -m experiments.calibration --size $(SIZE)
.PHONY: rejection

# Transfer starts from a network trained on ModelNet10, which CABLEJAX_DATA must hold.
fig13_transfer: pretrain
pretrain: $(VENV)/.run-stamp ## Train on ModelNet10 ($CABLEJAX_DATA), for fig13_transfer to start from
	@$(BIN)/python -m experiments.pretrain size=$(SIZE)
	@$(BIN)/python -m experiments.collect $@ --size $(SIZE)

# The study, an hour or two a day in the background; docs/study.md. PART="standard_nofit ablation" for some of it, MINUTES=110 to
# begin no run after, CORE=1 to pin it, DRY=1 to see the cost.
study: $(VENV)/.run-stamp ## Run what is missing of the study (docs/study.md); PART=..., MINUTES=110, DRY=1 lists its cost
	@code=0; $(BIN)/python -m experiments.study $(if $(PART),--part $(PART)) $(if $(MINUTES),--minutes $(MINUTES)) \
		$(if $(CORE),--core $(CORE)) $(if $(DRY),--dry) || code=$$?; \
	$(if $(DRY),,[ $$code = 130 ] || $(BIN)/python -m experiments.study_results $(if $(PART),--part $(PART)) || true;) exit $$code

attention: $(VENV)/.run-stamp ## Channel attention of a trained network: RUN=folder of a finished run of fig8_adgcnn
	@$(BIN)/python -m experiments.attention "$(RUN)"
.PHONY: pretrain study attention

results: $(OWN) $(TRAINED) figures ## Make the committed results anew (clean checkout; SIZE=paper for the long form)

reproduce: results ## Everything from nothing: results, figures, README, notebooks and report; SIZE=quick or paper
	@$(MAKE) --no-print-directory notebooks report

verify: $(VENV)/.run-stamp ## Repeat a sample of the committed results and compare
	@$(BIN)/python -m experiments.verify

tabulate: $(VENV)/.run-stamp ## Print parameters, FLOPs and shapes of every network
	@$(BIN)/python -m cablejax.nets.tabulate

tables: $(VENV)/.run-stamp ## Print the tables of results/
	@$(BIN)/python -m experiments.tables --results results

paper-tables: $(VENV)/.run-stamp ## Print Tables 1-3 in the paper's own layout, its values beside ours
	@$(BIN)/python -m experiments.tables --results results --paper

figures: $(VENV)/.run-stamp ## Draw results/figures and the README's numbers from results/
	@$(BIN)/python -m experiments.figures --results results --out results/figures
	@$(BIN)/python -m experiments.readme

report: $(VENV)/.run-stamp ## Make the HTML report from results/
	@$(BIN)/python -m experiments.report --results results --out runs/report.html

notebooks: $(VENV)/.dev-stamp ## Execute the notebooks on results/ and keep their output
	@$(BIN)/python -m experiments.notebooks

lab: $(VENV)/.dev-stamp ## Open the notebooks in Jupyter
	@$(BIN)/jupyter lab --core-mode --notebook-dir=.

# Tutorials are executed and kept until their text changes; warnings, broken links and misspellings end the build.
docs: $(VENV)/.docs-stamp ## Build the documentation into docs/_build/html (tutorials run; minutes the first time)
	@$(BIN)/typos --config docs/typos.toml
	@$(BIN)/python -m sphinx -b html -W --keep-going -q docs docs/_build/html
	@echo "$(CURDIR)/docs/_build/html/index.html"

release: $(VENV)/.dev-stamp ## Build and check sdist and wheel into dist/, with notes; nothing is uploaded (DRAFT=1 before it is ready)
	@$(BIN)/python -m tools.release $(if $(DRAFT),--draft)

COMPILE := $(BIN)/uv pip compile pyproject.toml --python-version 3.11 --universal --generate-hashes \
	--no-emit-index-url --no-emit-find-links --no-annotate --no-header --quiet -c requirements/held.in
lock: $(VENV)/.dev-stamp ## Resolve the locks in requirements/ anew (UPGRADE=1 to move versions)
	$(COMPILE) $(if $(UPGRADE),--upgrade) --extra all --extra peers --group build --group dev -o requirements/dev.txt
	awk '/^uv==/ { own = 1 } own { print } own && !/\\$$/ { exit }' requirements/dev.txt > requirements/uv.txt
	$(COMPILE) --group build -c requirements/dev.txt -o requirements/runtime.txt
	$(COMPILE) --group build --extra scan --extra study -c requirements/dev.txt -o requirements/study.txt
	$(COMPILE) --group build --group docs --extra scan --extra study --extra cad -c requirements/dev.txt -o requirements/docs.txt
	$(COMPILE) --group build --extra track -c requirements/dev.txt -o requirements/track.txt

clean: ## Remove runs, caches and the environment
	rm -rf runs .jax_cache .pytest_cache .ruff_cache build dist docs/_build docs/notebooks docs/reference/cablejax*.rst *.egg-info $(VENV)
