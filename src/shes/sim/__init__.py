"""Simulators: N copies of one MuJoCo model, on the CPU or on a device of Warp."""
