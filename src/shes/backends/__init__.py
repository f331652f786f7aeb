"""Backends: an ordered map and a broadcast over workers, here or in other processes."""
