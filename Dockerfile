# gaitcal in a container, as an ordinary user without rights; nothing in it listens on a network.
#
#   docker build -t gaitcal .
#   docker run --rm --network none -v "$PWD:/work" --user "$(id -u):$(id -g)" gaitcal calibrate study --out result
#
# `gaitcal example` alone needs a network: leave out `--network none` for it.
FROM python:3.12-slim AS build
WORKDIR /src
COPY pyproject.toml README.md LICENSE CHANGELOG.md CITATION.cff CONTRIBUTING.md ./
COPY gaitcal gaitcal
COPY models models
RUN python -m venv /opt/gaitcal && /opt/gaitcal/bin/pip install --no-cache-dir .

FROM python:3.12-slim
LABEL org.opencontainers.image.title="gaitcal" \
      org.opencontainers.image.licenses="BSD-3-Clause"
COPY --from=build /opt/gaitcal /opt/gaitcal
ENV PATH=/opt/gaitcal/bin:$PATH \
    HOME=/tmp \
    MPLCONFIGDIR=/tmp \
    OMP_NUM_THREADS=1
RUN useradd --create-home --uid 1000 gait && mkdir /work && chown gait:gait /work
USER 1000
WORKDIR /work
ENTRYPOINT ["gaitcal"]
CMD ["--help"]
