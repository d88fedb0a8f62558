"""The tools: gestures, brushes, cameras and playback, which turn events into edits of a document."""
