"""Stands in for trackio, which has the interface of wandb."""

from wandb import Run, init

__all__ = ["Run", "init"]
