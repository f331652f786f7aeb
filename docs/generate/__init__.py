"""What the documentation makes from the code when it is built, so that no page can go stale."""
