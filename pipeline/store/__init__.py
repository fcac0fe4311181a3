"""The published database: build, check, publish, query."""
