"""Views of runs: learning curves, videos, and a live viewer."""
