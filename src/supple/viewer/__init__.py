"""The window: its documents, tools, panels, and the windows themselves."""
