# Targets that need packages install the missing ones first (tools/setup).
.DEFAULT_GOAL := help
.PHONY: help setup demo test test-serial test-mpi test-docker lint docs docs-zip format doctor dist clean distclean
python := .venv/bin/python
RANKS ?= 2
JOBS ?= 2
version = $(shell sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)

# One thread per rank: MPI is the only parallelism.
export OMP_NUM_THREADS ?= 1
# Open MPI needs a core for each rank, unless told to oversubscribe (variables of versions 4, 5 and 6).
ifeq ($(shell lscpu -p=CORE,SOCKET | grep '^[0-9]' | sort -u | wc -l),1)
export OMPI_MCA_rmaps_base_oversubscribe ?= 1
export PRTE_MCA_rmaps_default_mapping_policy ?= :oversubscribe
export PRTE_MCA_mapby ?= :oversubscribe
endif
# All ranks are on this machine: no network transport is needed. Debian excludes the same ones but
# tcp, but setting this variable replaces its list; one of them sleeps for a second at every exit.
export OMPI_MCA_btl ?= ^tcp,uct,openib,ofi
# Open MPI runs as root, the usual user of a container, only if both variables are set.
ifeq ($(shell id -u),0)
export OMPI_ALLOW_RUN_AS_ROOT := 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM := 1
endif
# Containers forbid reading the memory of another process, which Open MPI 4 would try.
ifneq ($(wildcard /.dockerenv /run/.containerenv),)
export OMPI_MCA_btl_vader_single_copy_mechanism ?= none
endif

help:  ## show this list
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 14

setup:  ## install missing packages and make .venv/
	@tools/setup

demo: setup  ## stretch the cylinder and twist the cube on 2 ranks; results under out/
	mpirun -n $(RANKS) $(python) demos/cylinder_stretch.py
	mpirun -n $(RANKS) $(python) demos/cube_twist.py

test: lint test-serial test-mpi  ## lint, tests, and tests on 2 ranks

test-serial: setup  ## the tests on one rank, JOBS=2 at a time
	$(python) -m pytest -n $(JOBS) --dist worksteal $(PYTEST)

test-mpi: setup  ## the tests marked mpi, on RANKS=2 ranks
	tools/pytest-ranks $(RANKS) $(PYTEST)

test-docker:  ## the steps of the Dockerfile, in a Debian 13 root directory; then a run on 2 ranks
	.ci/in-root trixie -- bash -c "$$(tools/dockerfile-steps); \
		fem-snh run stretch --cells 3 --steps 1; mpirun --oversubscribe -n 2 fem-snh run twist --cells 2 --steps 1"

lint: setup  ## check with ruff and mypy
	$(python) -m ruff check .
	$(python) -m ruff format --check .
	$(python) -m mypy fem_snh benchmarks

docs: setup  ## build the documentation site in build/docs/html
	$(python) -m sphinx -W --keep-going -q -d build/docs/doctrees docs build/docs/html
	@echo "open build/docs/html/index.html"

docs-zip: docs  ## the site as one file, build/docs/fem_snh-VERSION-docs.zip
	cd build/docs && ../../$(python) -c 'import shutil, sys; print(shutil.make_archive(*sys.argv[1:]))' \
		fem_snh-$(version)-docs zip . html

format: setup  ## format and fix the code with ruff
	$(python) -m ruff check --fix .
	$(python) -m ruff format .

doctor: setup  ## check the installation
	$(python) -m fem_snh doctor

dist: setup  ## build the sdist and the wheel in dist/
	$(python) -c 'from setuptools import build_meta; build_meta.build_sdist("dist")' >/dev/null
	$(python) -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist dist/fem_snh-$(version).tar.gz

clean:  ## remove results and caches
	rm -rf out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +

distclean: clean  ## remove .venv/ as well
	rm -rf .venv
