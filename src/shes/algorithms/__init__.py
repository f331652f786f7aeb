"""The contract of learning algorithms."""
