# docker build -t motes . && docker run --rm -v "$PWD/out:/motes/out" motes demo
FROM python:3.13-slim
RUN apt-get update && apt-get install -y --no-install-recommends g++ libexpat1 && rm -rf /var/lib/apt/lists/*
COPY pyproject.toml README.md LICENSE /src/
COPY src /src/src
RUN pip install --no-cache-dir "/src[all]"
RUN useradd --create-home motes && mkdir /motes && chown motes /motes
USER motes
WORKDIR /motes
ENTRYPOINT ["motes"]
