"""Backends: an ordered map and a broadcast over workers, in this process or in others."""
