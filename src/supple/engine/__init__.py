"""The core's functions (`core`), the values that they take, and the streaming of frames."""
