# The wheel and what it needs: uv build --wheel && docker build --tag cadenza .
FROM python:3.12-slim
RUN --mount=type=bind,target=/context \
    pip install --no-cache-dir --requirement /context/requirements.lock && \
    pip install --no-cache-dir --no-deps /context/dist/cadenza-*.whl
# Whoever runs it may be any user, who has no home here.
ENV HOME=/tmp
WORKDIR /work
USER nobody
ENTRYPOINT ["cadenza"]
CMD ["--help"]
