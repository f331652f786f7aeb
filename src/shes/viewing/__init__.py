"""Looking at runs: curves, videos, a live viewer."""
