# make demo, make test: each installs what is missing first (tools/setup), so they work anywhere.
.DEFAULT_GOAL := help
.PHONY: help setup demo test test-serial test-mpi lint docs format doctor wheel clean distclean
python := .venv/bin/python
RANKS ?= 2
JOBS ?= 2

# One thread per rank: the ranks are the parallelism.
export OMP_NUM_THREADS ?= 1
# Open MPI counts cores, not hardware threads, and wants one per rank (names of 4, then of 5).
ifeq ($(shell lscpu -p=CORE,SOCKET | grep '^[0-9]' | sort -u | wc -l),1)
export OMPI_MCA_rmaps_base_oversubscribe ?= 1
export PRTE_MCA_rmaps_default_mapping_policy ?= :oversubscribe
endif
# All ranks are on this machine: no network to look for, nor to complain about. The others are those
# that Debian leaves out and would be there again; one of them sleeps for a second at every end.
export OMPI_MCA_btl ?= ^tcp,uct,openib,ofi
# Open MPI refuses to run as root, as one is in a container, unless told twice.
ifeq ($(shell id -u),0)
export OMPI_ALLOW_RUN_AS_ROOT := 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM := 1
endif
# Containers forbid reading another process' memory, which Open MPI 4 finds out by failing.
ifneq ($(wildcard /.dockerenv /run/.containerenv),)
export OMPI_MCA_btl_vader_single_copy_mechanism ?= none
endif

help:  ## this list
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 14

setup:  ## install what is missing and make .venv/
	@tools/setup

demo: setup  ## stretch the cylinder and twist the cube on 2 ranks; results under out/
	mpirun -n $(RANKS) $(python) demos/cylinder_stretch.py
	mpirun -n $(RANKS) $(python) demos/cube_twist.py

test: lint test-serial test-mpi  ## everything: lint, tests, tests on 2 ranks

test-serial: setup  ## the tests, each on one rank, so many side by side: JOBS=2
	$(python) -m pytest -n $(JOBS) --dist worksteal $(PYTEST)

test-mpi: setup  ## the tests marked mpi, on 2 ranks
	tools/pytest-ranks $(RANKS) $(PYTEST)

lint: setup  ## ruff and mypy
	$(python) -m ruff check .
	$(python) -m ruff format --check .
	$(python) -m mypy fem_snh benchmarks

docs: setup  ## the documentation site, in build/docs/html
	$(python) -m sphinx -W --keep-going -q -d build/docs/doctrees docs build/docs/html
	@echo "open build/docs/html/index.html"

format: setup  ## let ruff correct what it can
	$(python) -m ruff check --fix .
	$(python) -m ruff format .

doctor: setup  ## check the installation
	$(python) -m fem_snh doctor

wheel: setup  ## dist/fem_snh-*.whl
	$(python) -m pip wheel --quiet --no-deps --wheel-dir dist .

clean:  ## remove results and caches
	rm -rf out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +

distclean: clean  ## and .venv/
	rm -rf .venv
