# syntax=docker/dockerfile:1
FROM rust:1-slim-bookworm AS build
# The allocator is built with make, of whatever version.
# hadolint ignore=DL3008
RUN apt-get update && apt-get install -y --no-install-recommends make && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY Cargo.toml Cargo.lock build.rs ./
COPY .cargo .cargo
COPY numerics numerics
COPY tables tables
# The manifest names the benches.
COPY benches benches
# The dependencies alone first, so that a change of the sources does not build them again.
RUN mkdir src && echo 'fn main() {}' > src/main.rs && touch src/lib.rs src/numerics.rs src/tables.rs && cargo build --release --locked && rm -r src
COPY src src
RUN touch src/main.rs src/lib.rs src/numerics.rs src/tables.rs && cargo build --release --locked --bin stictiond

FROM debian:bookworm-slim
COPY --from=build /src/target/release/stictiond /usr/local/bin/stictiond
# Whom the system trusts: the slim image has nobody.
COPY --from=build /etc/ssl/certs/ca-certificates.crt /etc/ssl/certs/ca-certificates.crt
COPY LICENSE-MIT LICENSE-APACHE /usr/share/doc/stictiond/
USER 65532:65532
ENTRYPOINT ["/usr/local/bin/stictiond"]
CMD ["run", "--config", "/etc/stictiond/stictiond.toml"]
HEALTHCHECK --interval=30s --timeout=5s --start-period=10s CMD ["/usr/local/bin/stictiond", "health", "--config", "/etc/stictiond/stictiond.toml"]
