# truing alone: no compiler, no root, and no network while it runs. How to use it: docs/installing.md
FROM python:3.13-slim AS build
WORKDIR /source
COPY requirements/runtime.txt requirements/
RUN python -m venv /opt/truing \
 && /opt/truing/bin/python -m pip install --no-cache-dir --only-binary :all: --require-hashes -r requirements/runtime.txt
COPY pyproject.toml setup.py MANIFEST.in README.md LICENSE CHANGELOG.md CITATION.cff CONTRIBUTING.md ./
COPY truing truing
COPY schemas schemas
COPY stages stages
COPY pipeline pipeline
RUN /opt/truing/bin/python -m pip install --no-cache-dir --no-deps --no-build-isolation .

FROM python:3.13-slim
COPY --from=build /opt/truing /opt/truing
RUN useradd --create-home --uid 1000 truing
# Compiled kernels are kept where every user may write: the user's number is often that of the host.
ENV PATH="/opt/truing/bin:$PATH" NUMBA_CACHE_DIR=/tmp/truing-kernels
# By number, so that a host can tell that it is not root.
USER 1000
WORKDIR /data
ENTRYPOINT ["truing"]
CMD ["--help"]
