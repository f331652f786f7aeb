"""Training, evaluation and their construction from settings."""
