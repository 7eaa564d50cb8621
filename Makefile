# Needs Python 3.11 or later, and make; everything else goes into .venv: make run PYTHON=python3.13
PYTHON ?= $(firstword $(foreach name,python3.11 python3.12 python3.13 python3,$(shell command -v $(name))))
CRUISE ?= .
CORES ?= all
SEED ?= 7
N ?= 24
BIN := .venv/bin
# Jobs and tests run side by side: a second thread of linear algebra in each only waits for the others.
export OMP_NUM_THREADS ?= 1
PIP := $(BIN)/python -m pip --disable-pip-version-check install

RUN := $(BIN)/compass run "$(CRUISE)" --cores $(CORES)

.PHONY: concealed install cluster run verify check-archive test check bench accuracy proof schema docs clean lock

install: .venv/run  ## the pinned environment
.venv/run: requirements/run.txt pyproject.toml
.venv/test: requirements/test.txt pyproject.toml
.venv/docs: requirements/docs.txt pyproject.toml
# Compiled on all cores, where pip would take one. What the tests and the documentation need holds what a run needs.
.venv/run .venv/test .venv/docs: .venv/%:
	test -x $(BIN)/pip || $(PYTHON) -m venv .venv
	$(PIP) --no-compile --requirement requirements/$*.txt
	$(PIP) --no-deps --no-build-isolation --quiet --editable .
	-$(BIN)/python -m compileall -q -j 0 .venv/lib compasslib
	touch $@ .venv/run

cluster: install  ## what runs through Slurm and with files in a storage need besides, see docs/howto/cluster.md
	$(PIP) --no-deps --requirement requirements/cluster.txt

run: install  ## process a cruise: make run, or make run CRUISE=/data/my_cruise
	$(RUN)

concealed: install  ## four moorings with a concealed cause, drawn by SEED, beside the truth
	$(BIN)/python -m compasslib.demo.concealed build/concealed-$(SEED) $(SEED)
	$(BIN)/compass run build/concealed-$(SEED) --cores $(CORES)
	@echo "Comparison with the truth: build/concealed-$(SEED)/results/concealed.html"

verify: install  ## does an archive still hold what its manifest lists? make verify CRUISE=/data/my_cruise
	$(BIN)/compass verify "$(CRUISE)"

check-archive: .venv/test  ## CF and ACDD against a cruise's products
	$(BIN)/compliance-checker --test cf:1.11 --test acdd:1.3 $(wildcard $(CRUISE)/results/*/corrected.nc $(CRUISE)/results/*/gridded*.nc $(CRUISE)/results/sites/*/*.nc)

test: .venv/test  ## the tests
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

check: .venv/test  ## style, types, workflow
	$(BIN)/ruff check . && $(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/snakemake --lint

bench: .venv/test  ## speed of the readers against others, and memory of a long record
	$(BIN)/python benchmarks/throughput.py
	$(BIN)/python benchmarks/memory.py 1

accuracy: run .venv/test  ## the long measurements of how right the results are
	for name in accuracy calibrations recordings discrepancy injected; do \
	  echo "== $$name"; $(BIN)/python benchmarks/$$name.py || missed="$$missed $$name"; \
	done; test -z "$$missed" || { echo "a target is missed, or a run failed:$$missed"; exit 1; }

proof: install  ## sealed moorings by SEED, N of them, scored: build/proof/scorecard.md
	$(BIN)/python -m benchmarks.proof --seed $(SEED) --count $(N)

schema: install  ## JSON schemas of the YAML files, from the models
	$(BIN)/python -m compasslib.config.cruise config/schema

docs: .venv/docs  ## the documentation as a site, built without a network: build/docs/index.html
	$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet docs build/docs

lock:  ## newest versions into requirements/, with hashes; needs pip-tools
	for kind in run test docs; do \
	  extras="--extra workflow"; test $$kind = run || extras="$$extras --extra $$kind"; \
	  test $$kind != docs || extras="$$extras --constraint requirements/test.txt"; \
	  pip-compile --upgrade $$extras --all-build-deps --allow-unsafe --generate-hashes --no-annotate --strip-extras \
	    --no-emit-index-url --no-emit-trusted-host --no-emit-find-links -o requirements/$$kind.txt pyproject.toml; \
	done

clean:  ## results, caches and the environment; simulated raw files stay
	rm -rf .venv .snakemake results build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -exec rm -rf {} +
