# CPU:   docker build -t nsm .
# CUDA:  docker build -t nsm:cuda --build-arg BASE=nvidia/cuda:12.8.1-base-ubuntu24.04 .
#        docker run --gpus all -v "$PWD/outputs:/home/nsm/outputs" nsm:cuda trainer.accelerator=gpu
# Any Debian or Ubuntu base does; one that brings no Python 3.11 or newer gets its own distribution's.
ARG BASE=python:3.11-slim
FROM ${BASE}

ENV DEBIAN_FRONTEND=noninteractive \
    PIP_DISABLE_PIP_VERSION_CHECK=1 \
    PIP_NO_CACHE_DIR=1 \
    PYTHONUNBUFFERED=1 \
    PATH=/opt/nsm/bin:$PATH

# Pictures are drawn by Mesa's OpenGL, without a display or a graphics card.
# Versions of a distribution's packages belong to the base, which the caller pins.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libgl1-mesa-dri \
    && if ! command -v python3 >/dev/null; then apt-get install --yes --no-install-recommends python3 python3-venv; fi \
    && rm -rf /var/lib/apt/lists/* \
    && python3 -m venv /opt/nsm \
    && useradd --create-home --uid 10001 --user-group nsm \
    && install --directory --owner=nsm --group=nsm /home/nsm/outputs

# torch first, in a layer that a change of the code leaves alone.
COPY constraints.txt /tmp/nsm/
RUN pip install --constraint /tmp/nsm/constraints.txt torch

COPY pyproject.toml README.md LICENSE /tmp/nsm/
COPY conf /tmp/nsm/conf
COPY nsm /tmp/nsm/nsm
RUN pip install --constraint /tmp/nsm/constraints.txt '/tmp/nsm[all]'

USER 10001:10001
WORKDIR /home/nsm
VOLUME /home/nsm/outputs

ENTRYPOINT ["python", "-m"]
CMD ["nsm.train"]
