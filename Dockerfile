# fem_snh on Debian 13, without what only tests and documentation need. In a copy of the repository:
#   docker build -t fem-snh .
#   docker run --rm -v "$PWD/out:/out" fem-snh run twist --out /out/twist
# `make test-docker` runs these steps without Docker, in a root directory.
FROM debian:trixie-slim
COPY . /src/fem_snh
RUN apt-get update && apt-get install -y --no-install-recommends $(/src/fem_snh/tools/setup --packages) && rm -rf /var/lib/apt/lists/*
# petsc4py and dolfinx are compiled for Debian's numpy.
RUN python3 -m venv --system-site-packages /opt/fem_snh
RUN /opt/fem_snh/bin/pip install --no-cache-dir "/src/fem_snh[contact,export,movies,view]" "numpy==$(python3 -c 'import numpy; print(numpy.__version__)')"
# The usual user of a container is root, which Open MPI refuses unless it is told twice. One thread per rank.
ENV PATH=/opt/fem_snh/bin:/usr/sbin:/usr/bin:/sbin:/bin OMP_NUM_THREADS=1 OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
WORKDIR /out
RUN fem-snh doctor
ENTRYPOINT ["fem-snh"]
CMD ["--help"]
