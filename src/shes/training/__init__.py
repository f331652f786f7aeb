"""Training, evaluation and what they are built from."""
