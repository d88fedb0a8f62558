"""The document: strokes, their undo history, the autosave file, and file commands."""
