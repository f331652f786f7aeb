"""Environments: robots, worlds, and one file per task, batched over episodes."""
