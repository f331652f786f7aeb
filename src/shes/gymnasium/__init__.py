"""The environments as Gymnasium sees them: single and vector."""
