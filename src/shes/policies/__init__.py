"""Policies: networks over flat parameter vectors."""
