"""The windows: on a screen, in a notebook, or in a browser."""
