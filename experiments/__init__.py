"""The paper's experiments, the ablation and the walker study, and how agents are shipped: `python -m experiments`."""
