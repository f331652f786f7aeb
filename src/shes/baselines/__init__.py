"""HIRO and flat TD3: off-policy learning by gradients, as a baseline. Only `td3_update` and `learner` need JAX."""
