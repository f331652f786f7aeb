"""Policies: a flat parameter vector becomes a batched action."""
