"""External environments: any Gymnasium environment, with a function that locates its robot."""
