"""The document: strokes, their undo history, the autosave file, and the files that are opened and exported."""
