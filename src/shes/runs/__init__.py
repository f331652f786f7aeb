"""What a run folder is: configuration, checkpoints, tables, log, provenance."""
