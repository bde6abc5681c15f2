# murmurate on a CPU: docker build -t murmurate . && docker run --rm -v "$PWD/runs:/runs" murmurate discover C
FROM python:3.13-slim

WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY src src
RUN python -m pip install --no-cache-dir --constraint constraints.txt . \
    && useradd --create-home murmurate \
    && mkdir /runs \
    && chown murmurate /runs

USER murmurate
WORKDIR /
ENTRYPOINT ["murmurate"]
CMD ["--help"]
