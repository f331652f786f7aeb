"""Runs: training, resuming, evaluation, transfer, trained agents, export, and the run folder."""
