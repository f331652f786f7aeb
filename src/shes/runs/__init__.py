"""Run folders: configuration, checkpoints, tables, log, provenance."""
