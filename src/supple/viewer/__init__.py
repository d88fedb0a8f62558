"""The window, in four rooms: what is edited, the tools, the panels, and the windows that they run in."""
