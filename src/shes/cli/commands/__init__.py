"""The commands: plain functions. A new one is a function here and a line in `program`."""
