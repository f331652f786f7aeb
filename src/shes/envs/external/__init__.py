"""Environments of others: any Gymnasium environment, by a description of where robot and heading are."""
