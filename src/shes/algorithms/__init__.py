"""Learning algorithms: their contract, their registry, and the worker that runs their episodes."""
