"""Algorithms: what a learner is, and those that there are."""
