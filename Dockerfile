# leastaction with JupyterLab, and the examples; Binder takes this file as it is.
#
#   docker build --tag leastaction .
#   docker run --rm --volume "$PWD:/data" --workdir /data leastaction \
#     leastaction discover run.csv --coordinates theta --angles theta --known "cos(theta)=9.81" --output found
#   docker run --rm --publish 127.0.0.1:8888:8888 leastaction      # JupyterLab; it prints its address
FROM python:3.13-slim

# A compiler for the export of FMUs.
RUN apt-get update \
 && apt-get install --yes --no-install-recommends gcc libc6-dev \
 && rm -rf /var/lib/apt/lists/*

# Binder asks for a user with this name and number, and a home that is its own.
ARG NB_USER=jovyan
ARG NB_UID=1000
RUN useradd --create-home --uid ${NB_UID} ${NB_USER}
WORKDIR /home/${NB_USER}

# Dependencies first: a change of the sources leaves this layer as it is.
COPY pyproject.toml README.md LICENSE ./leastaction/
COPY src ./leastaction/src
RUN pip install --no-cache-dir "./leastaction[pandas,plot,excel,units,sklearn]" "jupyterlab>=4" "notebook>=7" "jupytext>=1.16"
COPY --chown=${NB_UID} examples ./examples

USER ${NB_USER}
ENV OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MPLCONFIGDIR=/tmp/matplotlib
CMD ["jupyter", "lab", "--ip=0.0.0.0", "--port=8888", "--no-browser"]
