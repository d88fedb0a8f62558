"""The window: what is drawn into it, what its events do, and what it keeps."""
