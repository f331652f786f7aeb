"""The environments as Gymnasium sees them: single, vector, registered."""
