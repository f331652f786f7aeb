"""Simulators: N copies of one MuJoCo model, on the CPU."""
