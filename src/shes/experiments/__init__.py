"""Experiments: settings, run folders, training, evaluation, plots. The only room that touches files."""
