"""Rollouts: the only loop over environment steps, its tasks and results, and the worker."""
